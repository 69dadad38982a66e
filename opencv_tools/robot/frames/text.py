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

"""The listing of the frames of a robot as text: a tree, a line for each frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from opencv_tools.robot.frames.listing import depth_first, parent_joints, transform_of

_INDENT = 2
_DEEPEST = 20  # levels that are indented; deeper links stand below each other
_MOST_POSITIONS = 4  # in a heading
_MODEL = '__model__'  # the name that SDF has for its frame
_Row = tuple[str, str, str, str]


def text(listing: Mapping[str, Any]) -> str:
    """
    Write a listing of frames as an indented tree: what it is, the frame it is in, xyz and rpy.

    A joint is in its parent link, at zero: the ``<origin>`` of URDF. A link is in the root link,
    at the positions of the joints. The ``<pose>`` of SDF has a line of its own where its numbers
    differ: that of a link in the model's frame, at zero, that of a joint in its child link.

    :param listing: as `frames.frames` returns it.
    """
    rows = [(heading(listing), 'in', 'xyz in metres', 'rpy in radians'), *_rows(listing)]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    return '\n'.join('  '.join([f'{cell:{width}}' for cell, width in zip(row, widths)]
                               + [row[3]]).rstrip() for row in rows)


def heading(listing: Mapping[str, Any]) -> str:
    """Return the name of the robot and the joints that are not at zero, if there are any."""
    put = [f'{name}={_joined(joint["position"])}' for name, joint in listing['joints'].items()
           if any(joint['position'])]
    more = ', ...' if len(put) > _MOST_POSITIONS else ''
    at = f' at {", ".join(put[:_MOST_POSITIONS])}{more}' if put else ''
    return f'robot {listing["robot"]}{at}'


def joint_text(name: str, joint: Mapping[str, Any]) -> str:
    """Return the name of a joint, its type, and its position if that is not zero."""
    at = f' at {_joined(joint["position"])}' if any(joint['position']) else ''
    return f'{name} ({joint["type"]}){at}'


def link_text(name: str, link: Mapping[str, Any]) -> str:
    """Return the name of a link, marked where joints have moved it."""
    return f'{name}, moved' if link['moved'] else name


def _rows(listing: Mapping[str, Any]) -> Iterator[_Row]:
    joints, above, root = listing['joints'], parent_joints(listing), listing['root']
    for name, depth in depth_first(listing):
        indent = ' ' * (_INDENT * min(depth, _DEEPEST))
        deep = f'({depth}) ' if depth > _DEEPEST else ''
        if name in above:
            yield from _joint_rows(f'{indent}{deep}joint', above[name], joints[above[name]])
        link = listing['links'][name]
        yield (f'{indent}{deep}link {link_text(name, link)}', root, *_texts(link['pose']))
        inner = f'{indent}{" " * _INDENT}- '
        placed = _numbers(link['in_model'])
        if placed != _texts(link['pose']):
            yield (f'{inner}<pose> in SDF', _MODEL, *placed)
        if link['inertial']:
            yield (f'{inner}inertial {link["inertial"]["mass"]:.5g} kg', root,
                   *_texts(link['inertial']['pose']))
        for kind in ('visual', 'collision'):
            for shape in link[f'{kind}s']:
                yield (f'{inner}{kind} {shape["name"]}'.rstrip(), root, *_texts(shape['pose']))
    for name, joint in joints.items():
        if above.get(joint['child']) != name:
            yield from _joint_rows(f'loop to {joint["child"]} by', name, joint)
    for name, frame in listing.get('frames', {}).items():
        yield (f'frame {name}  on {frame["attached_to"] or "the model"}', root,
               *_texts(frame['pose']))


def _joint_rows(start: str, name: str, joint: Mapping[str, Any]) -> Iterator[_Row]:
    yield (f'{start} {joint_text(name, joint)}', joint['parent'], *_numbers(joint['in_parent']))
    offset = _numbers(joint['in_child'])
    if offset != ('0 0 0', '0 0 0'):
        indent = ' ' * (len(start) - len(start.lstrip()) + _INDENT)
        yield (f'{indent}- <pose> in SDF', joint['child'], *offset)


def _texts(pose: Sequence[float]) -> tuple[str, str]:
    transform = transform_of(pose)
    return _joined(transform.translation), _joined(transform.pose().rpy)


def _numbers(placed: Mapping[str, Sequence[float]]) -> tuple[str, str]:
    return _joined(placed['xyz']), _joined(placed['rpy'])


def _joined(values: Sequence[float]) -> str:
    # Less than a nanometre is what rounding leaves of a zero.
    return ' '.join(f'{round(value, 9) + 0.0:.5g}' for value in values)
