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

"""Listing of the frames of a robot as a text tree."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from opencv_tools.robot.frames.listing import depth_first, Listing, parent_joints, transform_of
from opencv_tools.robot.xml.output import aligned

_INDENT = 2
_MAX_DEPTH = 20  # deeper links are not indented further
_MAX_POSITIONS = 4  # in the heading
_MODEL = '__model__'  # SDF's name of the model frame
_Row = tuple[str, str, str, str]


def text(listing: Listing) -> str:
    """
    Return a listing as an indented tree with columns: object, frame of reference, xyz, rpy.

    A joint is relative to its parent link at zero, as the ``<origin>`` of URDF. A link is relative
    to the root link at the joint positions. If the ``<pose>`` of SDF has other numbers, it has a
    row of its own. The pose of a link in SDF is relative to the model at zero, the pose of a joint
    to its child link.

    :param listing: a result of `listing.frames`.
    """
    return aligned([(heading(listing), 'in', 'xyz in metres', 'rpy in radians'), *_rows(listing)])


def heading(listing: Listing) -> str:
    """Return the name of the robot and the joints that are not at zero."""
    positions = [f'{name}={_joined(joint["position"])}'
                 for name, joint in listing['joints'].items() if any(joint['position'])]
    more = ', ...' if len(positions) > _MAX_POSITIONS else ''
    at = f' at {", ".join(positions[:_MAX_POSITIONS])}{more}' if positions else ''
    return f'robot {listing["robot"]}{at}'


def joint_text(name: str, joint: Mapping[str, Any]) -> str:
    """Return the name of a joint, its type, and its position if that is not zero."""
    at = f' at {_joined(joint["position"])}' if any(joint['position']) else ''
    return f'{name} ({joint["type"]}){at}'


def link_text(name: str, link: Mapping[str, Any]) -> str:
    """Return the name of a link, with a mark if joints have moved the link."""
    return f'{name}, moved' if link['moved'] else name


def _rows(listing: Listing) -> Iterator[_Row]:
    joints, parents, root = listing['joints'], parent_joints(listing), listing['root']
    for name, depth in depth_first(listing):
        indent = ' ' * (_INDENT * min(depth, _MAX_DEPTH))
        number = f'({depth}) ' if depth > _MAX_DEPTH else ''
        if name in parents:
            yield from _joint_rows(f'{indent}{number}joint', parents[name], joints[parents[name]])
        link = listing['links'][name]
        yield (f'{indent}{number}link {link_text(name, link)}', root, *_pose_cells(link['pose']))
        inner = f'{indent}{" " * _INDENT}- '
        in_model = _cells(link['in_model'])
        if in_model != _pose_cells(link['pose']):
            yield (f'{inner}<pose> in SDF', _MODEL, *in_model)
        if link['inertial']:
            yield (f'{inner}inertial {link["inertial"]["mass"]:.5g} kg', root,
                   *_pose_cells(link['inertial']['pose']))
        for kind in ('visual', 'collision'):
            for shape in link[f'{kind}s']:
                yield (f'{inner}{kind} {shape["name"]}'.rstrip(), root,
                       *_pose_cells(shape['pose']))
    for name, joint in joints.items():
        if parents.get(joint['child']) != name:
            yield from _joint_rows(f'loop to {joint["child"]} by', name, joint)
    for name, frame in listing.get('frames', {}).items():
        yield (f'frame {name}  on {frame["attached_to"] or "the model"}', root,
               *_pose_cells(frame['pose']))


def _joint_rows(start: str, name: str, joint: Mapping[str, Any]) -> Iterator[_Row]:
    yield (f'{start} {joint_text(name, joint)}', joint['parent'], *_cells(joint['in_parent']))
    in_child = _cells(joint['in_child'])
    if in_child != ('0 0 0', '0 0 0'):
        indent = ' ' * (len(start) - len(start.lstrip()) + _INDENT)
        yield (f'{indent}- <pose> in SDF', joint['child'], *in_child)


def _pose_cells(pose: Sequence[float]) -> tuple[str, str]:
    transform = transform_of(pose)
    return _joined(transform.translation), _joined(transform.pose().rpy)


def _cells(pose: Mapping[str, Sequence[float]]) -> tuple[str, str]:
    return _joined(pose['xyz']), _joined(pose['rpy'])


def _joined(values: Sequence[float]) -> str:
    # A value below a nanometre is a rounding error of zero.
    return ' '.join(f'{round(value, 9) + 0.0:.5g}' for value in values)
