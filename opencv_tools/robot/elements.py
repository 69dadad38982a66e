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

"""
What the readers understand of each element of URDF and SDF; all else is carried.

A table names attributes (``@name``) and children: None where all of it is understood, MANY where
it may occur often and each is read, a table for what is understood inside. docs/element_mapping.md
says the same for people.
"""

from __future__ import annotations

from collections.abc import Mapping

from opencv_tools.robot.carrying import Known, MANY

# Moments of inertia, in the order in which they are kept.
INERTIA = ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')
_VALUE: Known = {'#': None}  # the text of an element


def _attributes(*names: str) -> Known:
    return {f'@{name}': None for name in names}


def _children(*names: str) -> Known:
    return dict.fromkeys(names, _VALUE)


_ORIGIN = _attributes('xyz', 'rpy', 'quat_xyzw')

_URDF_SHAPE: dict[str, Known | None] = {
    '@name': None,
    'origin': _ORIGIN,
    'geometry': {
        'box': _attributes('size'),
        'sphere': _attributes('radius'),
        'cylinder': _attributes('radius', 'length'),
        'capsule': _attributes('radius', 'length'),
        'mesh': _attributes('filename', 'scale'),
    },
}
URDF_COLLISION: Known = _URDF_SHAPE
URDF_VISUAL: Known = {
    **_URDF_SHAPE,
    'material': {'@name': None, 'color': _attributes('rgba'), 'texture': _attributes('filename')},
}
URDF_LINK: Known = {
    '@name': None,
    'inertial': {'origin': _ORIGIN, 'mass': _attributes('value'),
                 'inertia': _attributes(*INERTIA)},
    'visual': MANY,
    'collision': MANY,
}
URDF_JOINT: Known = {
    **_attributes('name', 'type'),
    'origin': _ORIGIN,
    'parent': _attributes('link'),
    'child': _attributes('link'),
    'axis': _attributes('xyz'),
    'limit': _attributes('lower', 'upper', 'effort', 'velocity'),
    'dynamics': _attributes('damping', 'friction'),
    'mimic': _attributes('joint', 'multiplier', 'offset'),
}
# The limits of these say nothing about positions; other numbers that stand there are carried.
URDF_TURNING_JOINT: Known = {**URDF_JOINT, 'limit': _attributes('effort', 'velocity')}
_NO_AXIS: Known = {name: known for name, known in URDF_JOINT.items()
                   if name not in ('axis', 'limit', 'dynamics', 'mimic')}
# By type; without an axis that means anything, whatever stands there is carried.
URDF_JOINTS: Mapping[str, Known] = {
    'fixed': _NO_AXIS, 'floating': _NO_AXIS,
    'continuous': URDF_TURNING_JOINT, 'planar': URDF_TURNING_JOINT,
    'revolute': URDF_JOINT, 'prismatic': URDF_JOINT,
}
URDF_ROBOT: Known = {'@name': None, 'link': MANY, 'joint': MANY, 'gazebo': MANY}

_POSE = {**_VALUE, **_attributes('relative_to', 'frame', 'degrees', 'rotation_format')}
_SDF_SHAPE: dict[str, Known | None] = {
    '@name': None,
    'pose': _POSE,
    'geometry': {
        'box': _children('size'),
        'sphere': _children('radius'),
        'cylinder': _children('radius', 'length'),
        'capsule': _children('radius', 'length'),
        'mesh': _children('uri', 'scale'),
    },
}
SDF_COLLISION: Known = _SDF_SHAPE
SDF_VISUAL: Known = {
    **_SDF_SHAPE,
    'material': {
        **_children('ambient', 'diffuse', 'specular', 'emissive'),
        'pbr': {'metal': _children('albedo_map')},
    },
}
SDF_LINK: Known = {
    '@name': None,
    'pose': _POSE,
    'inertial': {'pose': _POSE, 'mass': _VALUE, 'inertia': _children(*INERTIA)},
    'visual': MANY,
    'collision': MANY,
}
_SDF_AXIS: Known = {
    'xyz': {**_VALUE, '@expressed_in': None},
    'use_parent_model_frame': _VALUE,
    'limit': _children('lower', 'upper', 'effort', 'velocity'),
    'dynamics': _children('damping', 'friction'),
    'mimic': {'@joint': None, **_children('multiplier', 'offset', 'reference')},
}
SDF_JOINT: Known = {
    **_attributes('name', 'type'),
    **_children('parent', 'child'),
    'pose': _POSE,
    'axis': _SDF_AXIS,
    'axis2': _SDF_AXIS,
}
SDF_FRAME: Known = {**_attributes('name', 'attached_to'), 'pose': _POSE}
SDF_MODEL: Known = {**_attributes('name', 'canonical_link'), 'link': MANY, 'joint': MANY,
                    'frame': MANY, 'model': MANY, 'include': MANY}

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
