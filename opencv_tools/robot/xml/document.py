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

import errno
from pathlib import Path
import re
import sys
from typing import TypeVar

from lxml import etree
from opencv_tools.regular_files import read_regular
from opencv_tools.robot.xml.report import Report, SourceLine
from opencv_tools.robot.xml.tracked import TrackedElement

Element = etree._Element
AnyElement = Element | TrackedElement
ElementT = TypeVar('ElementT', Element, TrackedElement)

MAX_BYTES = 100_000_000
# Tags, attributes and comments, which bound the memory and the time that a file takes.
_MAX_MARKUP = 1_000_000
# What the shell passes for <(command) is open already, as standard input is.
_OPEN_ALREADY = re.compile(r'/dev/stdin|/(?:dev|proc/self)/fd/\d+')
_URI = re.compile(r'([A-Za-z][A-Za-z0-9+.-]+):/+(.*)', re.DOTALL)
# In place of a comment: as long as it is, with its lines.
_BLANKS = bytes(byte if byte == ord('\n') else ord(' ') for byte in range(256))


class DescriptionError(ValueError):
    """A robot description that cannot be read, or cannot be written as asked."""

    def __init__(self, message: str, element: AnyElement | None = None, *, source: str = '',
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
        elif isinstance(line, SourceLine):
            source = line.source or source
        place = ':'.join([*filter(None, [source]), *([str(line)] if line else [])])
        super().__init__(': '.join(filter(None, [place, f'<{tag}>' if tag else '', message])))


def source_of(element: AnyElement) -> str:
    """Name the file that an element comes from."""
    return element.getroottree().docinfo.URL or ''


def line_of(element: AnyElement) -> int:
    """Return the line that an element begins at, 0 when it comes from no file."""
    return SourceLine(element.sourceline or 0, source_of(element))


def local_name(element: AnyElement) -> str:
    """Give the tag of an element without its namespace."""
    return str(element.tag).rpartition('}')[2]


def read_bytes(path: str) -> bytes:
    """
    Read a regular file, or standard input where it is called ``-``.

    :raises DescriptionError: it cannot be read, or is larger than any robot.
    """
    try:
        if path == '-':
            data = sys.stdin.buffer.read(MAX_BYTES + 1)
        elif _OPEN_ALREADY.fullmatch(path):
            with Path(path).open('rb') as file:
                data = file.read(MAX_BYTES + 1)
        else:
            data = read_regular(Path(path), MAX_BYTES)
    except OSError as err:
        if err.errno == errno.EFBIG:
            raise _too_large(path) from err
        raise DescriptionError(_why_not_read(path, err), source=display_name(path)) from err
    if len(data) > MAX_BYTES:
        raise _too_large(path)
    return data


def _too_large(path: str) -> DescriptionError:
    return DescriptionError(f'has more than {MAX_BYTES} bytes; that is no robot description',
                            source=display_name(path))


def _why_not_read(path: str, err: OSError) -> str:
    """Return why a file cannot be read, and what to name in its place."""
    uri = _URI.fullmatch(path)
    if not uri:
        return f'cannot be read: {err.strerror}'
    scheme, rest = uri.groups()
    package, _, inside = rest.partition('/')
    instead = {'file': f'name the file, /{rest}',
               'package': f'name the file, $(ros2 pkg prefix --share {package})/{inside}',
               'model': 'name the file or the folder of the model'}
    return (f'cannot be read: only files are read, and this is a URI of {scheme}:; '
            + instead.get(scheme.lower(), 'download the file and name it'))


def display_name(path: str) -> str:
    """Give the name of a file as messages have it."""
    return '<stdin>' if path == '-' else path


def parse(data: bytes, source: str, report: Report) -> Element:
    """
    Read XML without entities, without the network, and without what overflows the stack.

    What public files get wrong is read with a warning: a prefix that is not declared, ``--`` in a
    comment, text before the declaration, a declaration of version 0.0.

    :param source: the name of the file, for messages.
    :returns: the root element.
    :raises DescriptionError: it is not XML, declares entities, or has more in it than any robot.
    """
    if data.count(b'<') + data.count(b'=') > _MAX_MARKUP:
        raise DescriptionError(f'has more than {_MAX_MARKUP} tags, comments and attributes; that '
                               'is no robot description', source=source)
    entity = re.search(rb'<!ENTITY[^>]{0,80}', data)
    if entity:
        raise _entities(source, data.count(b'\n', 0, entity.start()) + 1)
    try:
        return _parsed(data, source)
    except etree.XMLSyntaxError as err:
        flaw = err
    mended = _repaired(data)
    if mended is None:
        raise DescriptionError(_sentence(flaw), source=source, line=flaw.lineno or 0) from flaw
    try:
        root = _parsed(mended, source)
    except etree.XMLSyntaxError as err:
        raise DescriptionError(_sentence(err), source=source, line=err.lineno or 0) from err
    report.warn(local_name(root), '', SourceLine(flaw.lineno or 0, source),
                f'not well-formed XML, read all the same: {_sentence(flaw)}')
    return root


def _parsed(data: bytes, source: str) -> Element:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False,
                             remove_comments=True, remove_pis=True)
    root = etree.fromstring(data, parser)
    root.getroottree().docinfo.URL = source  # older lxml escapes what base_url= gives
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


def _repaired(data: bytes) -> bytes | None:
    """Mend what public files get wrong, with every line where it was; None if nothing is."""
    start = re.search(rb'<\?xml[\s?]|<(sdf|robot)[\s>]', data)
    if start is None:
        return None
    # What stands before the declaration goes, its lines stay: they move into the root's tag.
    lines = data.count(b'\n', 0, start.start())
    mended = _without_dashes(re.sub(rb'\A(<\?xml\s+version\s*=\s*["\'])[\d.]*', rb'\g<1>1.0',
                                    data[start.start():], count=1))
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


def _without_dashes(data: bytes) -> bytes:
    """Blank the comments that have ``--`` in them."""
    blanked = bytearray(data)
    start = data.find(b'<!--')
    while start >= 0:
        end = data.find(b'-->', start + 4)
        if end < 0:
            break
        if data.find(b'--', start + 4, end + 1) >= 0:
            blanked[start + 4:end] = data[start + 4:end].translate(_BLANKS)
        start = data.find(b'<!--', end + 3)
    return bytes(blanked)


def required_name(element: AnyElement) -> str:
    """
    Give the name of an element that has to have one.

    :raises DescriptionError: it has none.
    """
    name = (element.get('name') or '').strip()
    if not name:
        raise DescriptionError('has no name', element)
    return name


def required_child(element: ElementT, tag: str) -> ElementT:
    """
    Give a child that an element has to have.

    :raises DescriptionError: it has none.
    """
    child = element.find(tag)
    if child is None:
        raise DescriptionError(f'has no <{tag}>', element)
    return child


def required_attribute(element: AnyElement, name: str) -> str:
    """
    Return an attribute that an element must have.

    :raises DescriptionError: the attribute is missing.
    """
    value = element.get(name)
    if value is None:
        raise DescriptionError(f'has no {name}=', element)
    return value


def to_bytes(root: Element) -> bytes:
    """Write a document, indented, with its declaration and no namespace that nothing uses."""
    etree.cleanup_namespaces(root)
    etree.indent(root)
    return b'<?xml version="1.0"?>\n' + etree.tostring(root, encoding='utf-8') + b'\n'
