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

"""XML of robots: read without its dangers, with what is not understood kept for later."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
import math
from pathlib import Path
import re
import sys

from lxml import etree
from opencv_tools.robot.pose import Vector
from opencv_tools.robot.report import Report

Element = etree._Element

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

_MAX_BYTES = 100_000_000


class DescriptionError(ValueError):
    """A robot description that cannot be read, or cannot be written as asked."""

    def __init__(self, message: str, element: Element | None = None, *, source: str = '',
                 line: int = 0, tag: str = '') -> None:
        """
        Say what is wrong and where.

        :param message: what is wrong, with the value, and what would be right.
        :param element: where; it tells line and tag.
        :param source: the file, where no element tells it.
        """
        if element is not None:
            source = source or source_of(element)
            line, tag = line_of(element), local_name(element)
        place = ':'.join([*filter(None, [source]), *([str(line)] if line else [])])
        super().__init__(': '.join(filter(None, [place, f'<{tag}>' if tag else '', message])))


def source_of(element: Element) -> str:
    """Name the file that an element comes from."""
    return element.getroottree().docinfo.URL or ''


def line_of(element: Element) -> int:
    """Give the line that an element begins at, 0 when it comes from no file."""
    return element.sourceline or 0


def local_name(element: Element) -> str:
    """Give the tag of an element without its namespace."""
    return etree.QName(element).localname


def read_bytes(path: str) -> bytes:
    """
    Read a file, or standard input where it is called ``-``.

    :raises DescriptionError: it cannot be read, or is larger than any robot.
    """
    try:
        if path == '-':
            data = sys.stdin.buffer.read(_MAX_BYTES + 1)
        else:
            with Path(path).open('rb') as file:
                data = file.read(_MAX_BYTES + 1)
    except OSError as err:
        raise DescriptionError(f'cannot be read: {err.strerror}', source=name_of(path)) from err
    if len(data) > _MAX_BYTES:
        raise DescriptionError(f'has more than {_MAX_BYTES} bytes; that is no robot description',
                               source=name_of(path))
    return data


def name_of(path: str) -> str:
    """Give the name of a file as messages have it."""
    return '<stdin>' if path == '-' else path


def parse(data: bytes, source: str, report: Report, *, tolerant: bool = False) -> Element:
    """
    Read XML without entities, without the network, and without what overflows the stack.

    :param source: the name of the file, for messages.
    :param tolerant: whether to read on, with a warning, what public SDF files get wrong: a prefix
        that is not declared, ``--`` in a comment, text before the declaration.
    :returns: the root element.
    :raises DescriptionError: it is not XML, or declares entities.
    """
    entity = re.search(rb'<!ENTITY[^>]{0,80}', data)
    if entity:
        raise DescriptionError('entities are not read; write what they stand for', source=source,
                               line=data.count(b'\n', 0, entity.start()) + 1, tag='!ENTITY')
    try:
        return _parsed(data, source)
    except etree.XMLSyntaxError as err:
        flaw = err
    mended = _mended(data) if tolerant else None
    if mended is None:
        raise DescriptionError(_sentence(flaw), source=source, line=flaw.lineno or 0) from flaw
    try:
        root = _parsed(mended, source)
    except etree.XMLSyntaxError as err:
        raise DescriptionError(_sentence(err), source=source, line=err.lineno or 0) from err
    report.warn(local_name(root), '', flaw.lineno or 0,
                f'not well-formed XML, read all the same: {_sentence(flaw)}')
    return root


def _parsed(data: bytes, source: str) -> Element:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False,
                             remove_comments=True, remove_pis=True)
    return etree.fromstring(data, parser, base_url=source)


def _sentence(err: etree.XMLSyntaxError) -> str:
    message = str(err.msg).partition('\n')[0]
    if message.startswith('Excessive depth'):
        return 'elements are nested more than 256 deep; no robot is'
    return f'not well-formed XML: {message}'


def _mended(data: bytes) -> bytes | None:
    """Mend what public SDF files get wrong, with every line where it was; None if nothing is."""
    start = re.search(rb'<\?xml[\s?]|<sdf[\s>]', data)
    if start is None:
        return None
    # What stands before the declaration goes, its lines stay: they move into the root's tag.
    lines = data.count(b'\n', 0, start.start())
    mended = data[start.start():]
    mended = re.sub(rb'<!--(.*?)-->', lambda comment: b'<!--' + re.sub(
        rb'-(?=-)|-$', b' ', comment[1]) + b'-->', mended, flags=re.DOTALL)
    declared = set(re.findall(rb'xmlns:([\w.-]+)\s*=', mended))
    used = set(re.findall(rb'</?([A-Za-z_][\w.-]*):[\w.-]+', mended)) | set(
        re.findall(rb'\s([A-Za-z_][\w.-]*):[\w.-]+\s*=\s*["\']', mended))
    missing = sorted(used - declared - {b'xmlns', b'xml'})
    declarations = b''.join(b' xmlns:%b="urn:undeclared:%b"' % (prefix, prefix)
                            for prefix in missing)
    mended = re.sub(rb'<sdf(?=[\s>])', lambda tag: tag[0] + b'\n' * lines + declarations,
                    mended, count=1)
    return mended if mended != data else None


def numbers(text: str | None, count: int, element: Element, what: str = '') -> tuple[float, ...]:
    """
    Read numbers that stand in a text.

    :param count: how many there have to be.
    :param what: the attribute that has them, for messages; empty for the text of the element.
    :raises DescriptionError: there are others, or one is not a number, or not finite.
    """
    try:
        values = tuple(map(_float, (text or '').split()))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        wanted = 'a finite number' if count == 1 else f'{count} finite numbers'
        subject = f'{what}=' if what else ''
        raise DescriptionError(f'{subject}{quoted(text)} is not {wanted}', element)
    return values


def number(text: str | None, element: Element, what: str = '') -> float:
    """Read one number, as `numbers` does."""
    return numbers(text, 1, element, what)[0]


def vector(text: str | None, element: Element, what: str = '') -> Vector:
    """Read three numbers, as `numbers` does."""
    x, y, z = numbers(text, 3, element, what)
    return x, y, z


def limit_number(text: str | None, element: Element, what: str = '') -> float:
    """Read one number that may be infinite."""
    try:
        value = _float((text or '').strip())
    except ValueError:
        value = math.nan
    if math.isnan(value):
        subject = f'{what}=' if what else ''
        raise DescriptionError(f'{subject}{quoted(text)} is not a number', element)
    return value


def quoted(text: str | None) -> str:
    """Quote a text in a message, the beginning of one that is long."""
    text = (text or '').strip()
    return repr(text if len(text) <= 60 else f'{text[:57]}...')


def _float(word: str) -> float:
    """Read a number as C does: Python's digits of other scripts and underscores are none."""
    if '_' in word or not word.isascii():
        raise ValueError
    return float(word)


def number_text(value: float) -> str:
    """Write a number so that reading it gives the same one, a whole one without a point."""
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


def numbers_text(values: tuple[float, ...]) -> str:
    """Write numbers with spaces between them."""
    return ' '.join(map(number_text, values))


def named(element: Element) -> str:
    """
    Give the name of an element that has to have one.

    :raises DescriptionError: it has none.
    """
    name = (element.get('name') or '').strip()
    if not name:
        raise DescriptionError('has no name', element)
    return name


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
        inner = known.get(tag, MANY) if tag in known else _UNKNOWN
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
    rest.extend(parts)
    return rest


_UNKNOWN: Known = {'': None}


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
    for child in children:
        if local_name(child) == _HOLDER:
            rest.extend(detached(part) for part in child)
        else:
            copy = detached(child)
            copy.tag = local_name(child)
            rest.append(copy)
    return rest


def to_bytes(root: Element) -> bytes:
    """Write a document, indented, with its declaration and no namespace that nothing uses."""
    etree.cleanup_namespaces(root)
    etree.indent(root)
    return b'<?xml version="1.0"?>\n' + etree.tostring(root, encoding='utf-8') + b'\n'
