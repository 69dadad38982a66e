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

"""Elements of URDF and SDF that several modules need."""

from __future__ import annotations

from collections.abc import Mapping

# Moments and products of inertia, in the order of the model.
INERTIA = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')

# Elements of SDF that Gazebo copies from <gazebo> and <gazebo reference> into the model, the link
# or the joint. The converter moves them between these places.
GAZEBO: Mapping[str, frozenset[str]] = {
    'model': frozenset({
        'allow_auto_disable', 'enable_wind', 'plugin', 'self_collide', 'static'}),
    'link': frozenset({
        'audio_sink', 'audio_source', 'battery', 'enable_wind', 'gravity', 'kinematic', 'light',
        'must_be_base_link', 'particle_emitter', 'plugin', 'projector', 'self_collide', 'sensor',
        'velocity_decay'}),
    'joint': frozenset({'sensor'}),
}
# Elements of a link that have a pose, by default in the frame of the link.
POSED = frozenset({'audio_source', 'light', 'particle_emitter', 'projector', 'sensor'})
