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

"""What a reader does not understand, kept for the way back in a namespace of its own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import deepcopy

from lxml import etree
from opencv_tools.robot.report import Report
from opencv_tools.robot.xml import Element, local_name

# Elements and attributes that only the other format understands are kept in these namespaces.
URDF_NAMESPACE = 'urn:opencv_tools:urdf'
SDF_NAMESPACE = 'urn:opencv_tools:sdf'
_OURS = (f'{{{URDF_NAMESPACE}}}', f'{{{SDF_NAMESPACE}}}')
# An element that has a namespace already is kept in one of this name, and so is a second pose, for
# <sdf:pose> says where the frame of a link was.
_HOLDER = 'element'
_HELD = 'pose'

# What a reader understands of an element: of its attributes (``@name``) and children each is None
# (all of it), MANY (all of each, however often it occurs) or a table for what is in the child.
Known = Mapping[str, 'Known | None']
MANY: Known = {}
_UNKNOWN: Known = {'': None}


def leftovers(element: Element, known: Known) -> Element | None:
    """
    Give what of an element a reader does not understand.

    :param known: what it does understand.
    :returns: an element of the same tag that has only attributes and children that are not
        known; those of a child that occurs twice where one is expected, too. None when there are
        none. What is kept for the other format does not count.
    """
    parts = []
    seen = set()
    for child in element:
        tag = child.tag
        if not isinstance(tag, str) or tag.startswith(_OURS):
            continue
        inner = known.get(tag, _UNKNOWN)
        if inner is _UNKNOWN or (tag in seen and inner is not MANY):
            part: Element | None = detached(child)
        elif inner is None or inner is MANY:
            part = None
        else:
            part = leftovers(child, inner)
        seen.add(tag)
        if part is not None:
            parts.append(part)
    attributes = {name: value for name, value in element.attrib.items()
                  if f'@{name}' not in known and not str(name).startswith(_OURS)}
    if not parts and not attributes:
        return None
    rest = etree.Element(element.tag, attributes, nsmap=element.nsmap)
    rest.getroottree().docinfo.URL = element.getroottree().docinfo.URL  # for messages about it
    rest.extend(parts)
    return rest


def detached(element: Element) -> Element:
    """Copy an element without the text that follows it."""
    copy = deepcopy(element)
    copy.tail = None
    return copy


def restore(element: Element, rest: Element | None, known: Known) -> None:
    """
    Put back into an element what `leftovers` gave of it.

    :param element: as it was written from what is known; it is changed.
    """
    if rest is None:
        return
    for name, value in rest.attrib.items():
        element.set(name, value)
    for part in rest:
        tag = str(part.tag)
        inner = known.get(tag)
        target = element.find(tag) if inner and not _repeats(part, inner) else None
        if target is None:
            element.append(detached(part))
        else:
            restore(target, part, inner or {})


def _repeats(part: Element, known: Known) -> bool:
    """Tell whether a part has what is known, as one has that was there a second time."""
    if '#' in known and (part.text or '').strip():
        return True
    if any(f'@{name}' in known for name in part.attrib):
        return True
    for child in part:
        tag = str(child.tag)
        if tag in known:
            inner = known[tag]
            if inner is None or (inner is not MANY and _repeats(child, inner)):
                return True
    return False


def carry(element: Element, rest: Element | None, namespace: str) -> list[str]:
    """
    Put into an element what only the other format understands, in a namespace of its own.

    :param element: as it was written from what is known; it is changed.
    :returns: the tags and attributes that were put there.
    """
    if rest is None:
        return []
    for name, value in rest.attrib.items():
        element.set(name if str(name).startswith('{') else f'{{{namespace}}}{name}', value)
    for part in rest:
        copy, tag = detached(part), str(part.tag)
        if tag.startswith('{') or tag == _HELD:
            holder = etree.SubElement(element, f'{{{namespace}}}{_HOLDER}')
            holder.append(copy)
        else:
            copy.tag = f'{{{namespace}}}{tag}'
            element.append(copy)
    return [*(f'@{name}' for name in rest.attrib), *(local_name(part) for part in rest)]


def carried(element: Element, namespace: str, skip: tuple[str, ...] = ()) -> Element | None:
    """
    Take from an element what `carry` put there.

    :param skip: tags and ``@attributes`` that the caller reads itself.
    :returns: an element without the namespace; None when there is nothing.
    """
    prefix = f'{{{namespace}}}'
    children = [child for child in element.iterchildren(f'{prefix}*')
                if local_name(child) not in skip]
    attributes = {str(name).removeprefix(prefix): value for name, value in element.attrib.items()
                  if str(name).startswith(prefix)
                  and f'@{str(name).removeprefix(prefix)}' not in skip}
    if not children and not attributes:
        return None
    rest = etree.Element(local_name(element), attributes, nsmap=element.nsmap)
    rest.getroottree().docinfo.URL = element.getroottree().docinfo.URL  # for messages about it
    for child in children:
        if local_name(child) == _HOLDER:
            rest.extend(detached(part) for part in child)
        else:
            copy = detached(child)
            copy.tag = local_name(child)
            rest.append(copy)
    return rest


def note_carried(report: Report, namespace: str, name: str, line: int, tags: Iterable[str]
                 ) -> None:
    """Note each thing of `carry` that only one of the formats has a word for."""
    other, prefix = ('SDF', 'urdf') if namespace == URDF_NAMESPACE else ('URDF', 'sdf')
    for tag in tags:
        # The name that a thing had is what its renaming notes already.
        if tag != '@name':
            kept = f'attribute {prefix}:{tag[1:]}' if tag.startswith('@') else f'<{prefix}:{tag}>'
            report.carry(tag, name, line, f'{other} has no word for it; kept as {kept}')
