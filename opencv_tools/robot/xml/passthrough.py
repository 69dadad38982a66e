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
XML that a reader does not consume, preserved for the conversion back.

What only URDF can express has the prefix ``urdf`` in SDF. What only SDF can express has the prefix
``sdf`` in URDF. Unread XML is in an element ``<preserved:urdf>`` or ``<preserved:sdf>``.
"""

from __future__ import annotations

from collections.abc import Iterable

from lxml import etree
from opencv_tools.robot.xml.document import (
    detached, Element, local_name, PARTLY_READ, TEXT_READ, TrackedElement)
from opencv_tools.robot.xml.report import Report

URDF_NAMESPACE = 'urn:opencv_tools:urdf'
SDF_NAMESPACE = 'urn:opencv_tools:sdf'
_PRESERVED = 'urn:opencv_tools:preserved'
PREFIXES = {'urdf': URDF_NAMESPACE, 'sdf': SDF_NAMESPACE, 'preserved': _PRESERVED}
# Beginnings of the tags and attributes that only one format has.
URDF_TAG, SDF_TAG = f'{{{URDF_NAMESPACE}}}', f'{{{SDF_NAMESPACE}}}'
# The name that an element has in URDF, if SDF does not allow it.
URDF_NAME = f'{URDF_TAG}name'
# The type that a joint has in URDF, if SDF does not have it or reads another one.
URDF_JOINT_TYPE = f'{URDF_TAG}type'
_OTHER_FORMAT = {'urdf': 'SDF', 'sdf': 'URDF'}


def merge_unread(element: Element, unread: Element | None, *, marked: bool = False,
                 in_front: bool = False) -> None:
    """
    Add unread XML to an element of the same format.

    :param element: element that was written from the model; it is changed.
    :param unread: result of `TrackedElement.unread`.
    :param marked: whether to keep ``PARTLY_READ``, because the element is itself preserved.
    :param in_front: whether a child precedes others with its tag, of which the first counts.
    """
    if unread is None:
        return
    written = {child.tag: child for child in reversed(element)}
    if unread.text and not element.text:
        element.text = unread.text
    for name, value in unread.attrib.items():
        if name != PARTLY_READ:
            element.set(name, value)
    for child in unread:
        target = written.get(child.tag) if PARTLY_READ in child.attrib else None
        if target is not None:
            merge_unread(target, child, marked=marked, in_front=in_front)
        elif child.get(PARTLY_READ) != TEXT_READ or _is_repeated(child):
            # An element whose text is gone is left out, unless another one would take its place.
            copy = detached(child)
            if not marked:
                etree.strip_attributes(copy, PARTLY_READ)
            if in_front and child.tag in written:
                written[child.tag].addprevious(copy)
            else:
                element.append(copy)


def _is_repeated(element: Element) -> bool:
    """Return whether another element with the tag follows, of which nothing was read."""
    return any(PARTLY_READ not in other.attrib for other in element.itersiblings(str(element.tag)))


def embed_foreign(element: Element, unread: Element | None, origin: str, report: Report,
                  name: str, line: int) -> None:
    """
    Add unread XML of the other format to an element, inside ``<preserved:...>``.

    :param element: element that was written from the model; it is changed.
    :param unread: result of `TrackedElement.unread`.
    :param origin: the format of the unread XML, ``urdf`` or ``sdf``.
    """
    if unread is None:
        return
    copy = detached(unread)
    copy.tag = f'{{{_PRESERVED}}}{origin}'
    if origin == 'urdf' and 'name' in copy.attrib:
        element.set(URDF_NAME, copy.attrib.pop('name'))
    if not len(copy) and not copy.attrib and not copy.text:
        return
    element.append(copy)
    for tag in (*(f'@{etree.QName(key).localname}' for key in copy.attrib),
                *map(local_name, copy)):
        report.preserve(tag, name, line, f'not supported by {_OTHER_FORMAT[origin]}; preserved in '
                        f'<preserved:{origin}>')


def extract_foreign(element: TrackedElement, origin: str) -> Element | None:
    """
    Read what `embed_foreign` added to an element.

    :param origin: the format of the unread XML, ``urdf`` or ``sdf``.
    :returns: an element with the tag of the element; None if nothing was added.
    """
    name = element.get(URDF_NAME) if origin == 'urdf' else None
    preserved = element.take_first(f'{{{_PRESERVED}}}{origin}')
    if preserved is None and name is None:
        return None
    tag = local_name(element)
    unread = etree.Element(tag) if preserved is None else detached(preserved.element)
    unread.tag = tag
    if name is not None:
        unread.set('name', name)
    return unread


def report_preserved(report: Report, origin: str, name: str, line: int, tag: str) -> None:
    """Report an element or an ``@attribute`` in the namespace of the only format that has it."""
    kept = f'attribute {origin}:{tag[1:]}' if tag.startswith('@') else f'<{origin}:{tag}>'
    report.preserve(tag, name, line,
                    f'not supported by {_OTHER_FORMAT[origin]}; preserved as {kept}')


def namespaces(elements: Iterable[Element], origin: str) -> dict[str | None, str]:
    """
    Return the namespaces of a document that is written, by prefix.

    :param elements: unread elements in the document, whose namespaces are kept.
    :param origin: the format that is not the one of the document, ``urdf`` or ``sdf``.
    """
    found = {prefix: uri for element in elements for prefix, uri in element.nsmap.items()
             if prefix and uri not in PREFIXES.values()}
    return {**dict(sorted(found.items())), origin: PREFIXES[origin], 'preserved': _PRESERVED}
