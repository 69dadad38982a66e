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

"""XML of robots: read without its dangers, and written."""

from __future__ import annotations

from pathlib import Path
import re
import sys
from typing import TypeVar

from lxml import etree
from opencv_tools.robot.report import Report
from opencv_tools.robot.taken import Taken

Element = etree._Element
Either = TypeVar('Either', Element, Taken)

_MAX_BYTES = 100_000_000


class DescriptionError(ValueError):
    """A robot description that cannot be read, or cannot be written as asked."""

    def __init__(self, message: str, element: Element | Taken | None = None, *, source: str = '',
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


def source_of(element: Element | Taken) -> str:
    """Name the file that an element comes from."""
    return element.getroottree().docinfo.URL or ''


def line_of(element: Element | Taken) -> int:
    """Give the line that an element begins at, 0 when it comes from no file."""
    return element.sourceline or 0


def local_name(element: Element | Taken) -> str:
    """Give the tag of an element without its namespace."""
    return str(element.tag).rpartition('}')[2]


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


def parse(data: bytes, source: str, report: Report) -> Element:
    """
    Read XML without entities, without the network, and without what overflows the stack.

    What public files get wrong is read with a warning: a prefix that is not declared, ``--`` in a
    comment, text before the declaration, a declaration of version 0.0.

    :param source: the name of the file, for messages.
    :returns: the root element.
    :raises DescriptionError: it is not XML, or declares entities.
    """
    entity = re.search(rb'<!ENTITY[^>]{0,80}', data)
    if entity:
        raise _entities(source, data.count(b'\n', 0, entity.start()) + 1)
    try:
        return _parsed(data, source)
    except etree.XMLSyntaxError as err:
        flaw = err
    mended = _mended(data)
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
    root = etree.fromstring(data, parser, base_url=source)
    # In an encoding other than ASCII's the declarations do not show before they are parsed.
    dtd = root.getroottree().docinfo.internalDTD
    if dtd is not None and any(True for _ in dtd.iterentities()):
        raise _entities(source)
    return root


def _entities(source: str, line: int = 0) -> DescriptionError:
    return DescriptionError('entities are not read; write what they stand for', source=source,
                            line=line, tag='!ENTITY')


def _sentence(err: etree.XMLSyntaxError) -> str:
    message = str(err.msg).partition('\n')[0]
    if message.startswith('Excessive depth'):
        return 'elements are nested more than 256 deep; no robot is'
    return f'not well-formed XML: {message}'


def _mended(data: bytes) -> bytes | None:
    """Mend what public files get wrong, with every line where it was; None if nothing is."""
    start = re.search(rb'<\?xml[\s?]|<(sdf|robot)[\s>]', data)
    if start is None:
        return None
    # What stands before the declaration goes, its lines stay: they move into the root's tag.
    lines = data.count(b'\n', 0, start.start())
    mended = data[start.start():]
    mended = re.sub(rb'^(<\?xml\s+version\s*=\s*["\'])[\d.]*', rb'\g<1>1.0', mended)
    mended = re.sub(rb'<!--(.*?)-->', lambda comment: b'<!--' + re.sub(
        rb'-(?=-)|-$', b' ', comment[1]) + b'-->', mended, flags=re.DOTALL)
    declared = set(re.findall(rb'xmlns:([\w.-]+)\s*=', mended))
    used = set(re.findall(rb'</?([A-Za-z_][\w.-]*):[\w.-]+', mended)) | set(
        re.findall(rb'\s([A-Za-z_][\w.-]*):[\w.-]+\s*=\s*["\']', mended))
    missing = sorted(used - declared - {b'xmlns', b'xml'})
    if b'xacro' in missing:  # what it says would not be done
        return None
    declarations = b''.join(b' xmlns:%b="urn:undeclared:%b"' % (prefix, prefix)
                            for prefix in missing)
    mended = re.sub(rb'<(sdf|robot)(?=[\s>])', lambda tag: tag[0] + b'\n' * lines + declarations,
                    mended, count=1)
    mended = re.sub(rb'\A<\?xml\s+(?!version)', b'<?xml version="1.0" ', mended, count=1)
    return mended if mended != data else None


def named(element: Element | Taken) -> str:
    """
    Give the name of an element that has to have one.

    :raises DescriptionError: it has none.
    """
    name = (element.get('name') or '').strip()
    if not name:
        raise DescriptionError('has no name', element)
    return name


def child_of(element: Either, tag: str) -> Either:
    """
    Give a child that an element has to have.

    :raises DescriptionError: it has none.
    """
    child = element.find(tag)
    if child is None:
        raise DescriptionError(f'has no <{tag}>', element)
    return child


def to_bytes(root: Element) -> bytes:
    """Write a document, indented, with its declaration and no namespace that nothing uses."""
    etree.cleanup_namespaces(root)
    etree.indent(root)
    return b'<?xml version="1.0"?>\n' + etree.tostring(root, encoding='utf-8') + b'\n'
