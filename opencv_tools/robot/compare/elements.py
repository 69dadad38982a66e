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

"""Elements that the model of a robot only keeps, such as sensors, as properties by their paths."""

from __future__ import annotations

from collections.abc import Iterator
import math

from opencv_tools.robot.compare.properties import plain_uri, Properties, Value
from opencv_tools.robot.model import Extension
from opencv_tools.robot.renaming import flat_name
from opencv_tools.robot.sdf.values import pose_of
from opencv_tools.robot.xml.document import DescriptionError, Element, local_name
from opencv_tools.robot.xml.numbers import c_float

_FLAGS = {'true': (1.0,), 'false': (0.0,)}


def element_properties(extension: Extension) -> Properties:
    """
    Return all attributes and texts of the kept elements by path, with numbers as numbers.

    A path such as ``sensor[camera]/update_rate`` has the names of elements, or their numbers where
    several have one tag. An empty element is ``present``. The order of different tags, comments
    and spaces do not matter. Paths of URDF begin with ``urdf:``.
    """
    properties: Properties = {}
    for prefix, root in (('', extension.sdf), ('urdf:', extension.urdf)):
        if root is not None:
            properties.update((prefix + path.lstrip('/'), value) for path, value in _values(root))
    return properties


def _values(element: Element, path: str = '') -> Iterator[tuple[str, Value]]:
    attributes = {str(name): str(value) for name, value in element.attrib.items()
                  if not str(name).startswith('{')}
    text = (element.text or '').strip()
    children = list(element.iterchildren('*'))
    if element.tag == 'pose' and (numbers := _pose(element)):
        yield path, numbers
        attributes = {name: attributes[name] for name in attributes if name == 'relative_to'}
    elif text or not (children or element.attrib):
        yield path, _value(text) if text else 'present'
    for name, value in attributes.items():
        yield f'{path}@{name}', _value(value)
    by_tag: dict[str, list[Element]] = {}
    for child in children:
        by_tag.setdefault(local_name(child), []).append(child)
    for tag, siblings in by_tag.items():
        names = [flat_name(child.get('name', '')) for child in siblings]
        if not all(names) or len(set(names)) < len(names):
            names = [''] if len(siblings) == 1 else list(map(str, range(len(siblings))))
        for name, child in zip(names, siblings):
            yield from _values(child, f'{path}/{tag}[{name}]' if name else f'{path}/{tag}')


def _pose(element: Element) -> tuple[float, ...]:
    """Return a pose in metres and radians; empty for other texts, which plugins may have."""
    try:
        pose = pose_of(element)
    except DescriptionError:
        return ()
    return *pose.xyz, *pose.rpy


def _value(text: str) -> Value:
    """Return the numbers of a text, of a flag 1 or 0, else the text as both formats write it."""
    if flag := _FLAGS.get(text.lower()):
        return flag
    try:
        numbers = tuple(map(c_float, text.split()))
    except ValueError:
        return plain_uri(flat_name(' '.join(text.split())))
    return numbers if numbers and all(map(math.isfinite, numbers)) else text
