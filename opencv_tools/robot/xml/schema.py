# Copyright 2026 opencv_tools maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Elements of SDF that other modules have to know by name."""

from __future__ import annotations

from collections.abc import Mapping

# Moments of inertia, in the order in which they are kept.
INERTIA = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')

# What Gazebo takes from <gazebo> and <gazebo reference> as it is. In URDF that is where these
# elements of SDF belong, and in SDF they stand in the model, the link and the joint themselves.
GAZEBO: Mapping[str, frozenset[str]] = {
    'model': frozenset({
        'allow_auto_disable', 'enable_wind', 'plugin', 'self_collide', 'static'}),
    'link': frozenset({
        'audio_sink', 'audio_source', 'battery', 'enable_wind', 'gravity', 'kinematic', 'light',
        'must_be_base_link', 'particle_emitter', 'plugin', 'projector', 'self_collide', 'sensor',
        'velocity_decay'}),
    'joint': frozenset({'sensor'}),
}
# Those of a link that have a pose of their own, in its frame where they do not say otherwise.
POSED = frozenset({'audio_source', 'light', 'particle_emitter', 'projector', 'sensor'})
