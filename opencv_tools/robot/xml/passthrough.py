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

"""What a reader did not take of an element: carried in the other format, and put back."""

from __future__ import annotations

from collections.abc import Iterable

from lxml import etree
from opencv_tools.robot.xml.document import Element, local_name
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.tracked import detached, PARTLY_READ, TEXT_READ, TrackedElement

# What a writer notes for the reader of the way back has the namespace of the format that it is
# about. What was not read is in an element of a namespace of its own, in the words of its format.
URDF_NAMESPACE = 'urn:opencv_tools:urdf'
SDF_NAMESPACE = 'urn:opencv_tools:sdf'
_PRESERVED = 'urn:opencv_tools:preserved'
PREFIXES = {'urdf': URDF_NAMESPACE, 'sdf': SDF_NAMESPACE, 'preserved': _PRESERVED}
# The name that an element has in URDF, if SDF does not allow it.
URDF_NAME = f'{{{URDF_NAMESPACE}}}name'


def merge_unread(element: Element, rest: Element | None, *, marked: bool = False) -> None:
    """
    Put back into an element what `TrackedElement.rest` left of it.

    :param element: the element as it was written from what was read; it is changed.
    :param marked: whether ``PARTLY_READ`` stays, because the element is to be carried itself.
    """
    if rest is None:
        return
    written = {child.tag: child for child in reversed(element)}
    if rest.text and not element.text:
        element.text = rest.text
    for name, value in rest.attrib.items():
        if name != PARTLY_READ:
            element.set(name, value)
    for part in rest:
        target = written.get(part.tag) if PARTLY_READ in part.attrib else None
        if target is None and part.get(PARTLY_READ) == TEXT_READ:
            continue  # what has no text any more has no attributes
        if target is None:
            copy = detached(part)
            if not marked:
                etree.strip_attributes(copy, PARTLY_READ)
            element.append(copy)
        else:
            merge_unread(target, part, marked=marked)


def embed_foreign(element: Element, rest: Element | None, language: str, report: Report, name: str,
          line: int) -> None:
    """
    Put into an element what only the other format has a word for.

    :param element: the element as it was written from what was read; it is changed.
    :param language: the format that has the words, ``urdf`` or ``sdf``.
    :param name: the name of the thing, for the report.
    """
    if rest is None:
        return
    copy = detached(rest)
    copy.tag = f'{{{_PRESERVED}}}{language}'
    if language == 'urdf' and 'name' in copy.attrib:
        element.set(URDF_NAME, copy.attrib.pop('name'))
    if not len(copy) and not copy.attrib and not copy.text:
        return
    element.append(copy)
    other = 'SDF' if language == 'urdf' else 'URDF'
    for tag in (*(f'@{etree.QName(name).localname}' for name in copy.attrib),
                *map(local_name, copy)):
        report.preserve(tag, name, line,
                        f'not supported by {other}; preserved in <preserved:{language}>')


def extract_foreign(taken: TrackedElement, language: str) -> Element | None:
    """
    Take from an element what `embed_foreign` put there.

    :returns: an element of the same tag; None where nothing is carried.
    """
    own = taken.get(URDF_NAME) if language == 'urdf' else None
    found = taken.take_first(f'{{{_PRESERVED}}}{language}')
    if found is None and own is None:
        return None
    tag = local_name(taken)
    rest = etree.Element(tag) if found is None else detached(found.element)
    rest.tag = tag
    if own is not None:
        rest.set('name', own)
    return rest


def report_preserved(report: Report, prefix: str, name: str, line: int, tag: str) -> None:
    """Note what is in the namespace of the one format that has a word for it."""
    other = 'SDF' if prefix == 'urdf' else 'URDF'
    kept = f'attribute {prefix}:{tag[1:]}' if tag.startswith('@') else f'<{prefix}:{tag}>'
    report.preserve(tag, name, line, f'not supported by {other}; preserved as {kept}')


def namespaces(elements: Iterable[Element], own: str) -> dict[str | None, str]:
    """
    Return the namespaces of a document that is written, by prefix.

    :param elements: unread elements that are in the document; their namespaces are kept.
    :param own: the prefix of what the writer notes, ``urdf`` or ``sdf``.
    """
    found = {prefix: uri for element in elements for prefix, uri in element.nsmap.items()
             if prefix}
    return {**dict(sorted(found.items())), own: PREFIXES[own], 'preserved': _PRESERVED}
