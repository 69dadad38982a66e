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
Documents of XML: robot descriptions that are read safely, and written.

Errors of XML that public robot descriptions have are repaired. Every element keeps its line.

===================================  =========================================================
error                                repair
===================================  =========================================================
text before the XML declaration      is removed
XML declaration of another version   has version 1.0
XML declaration without a version    has version 1.0
comment with ``--``                  is blanked
prefix without a declaration         is declared on the root element
===================================  =========================================================
"""

from __future__ import annotations

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
# Largest number of tags, attributes and comments. It bounds memory and time.
_MAX_MARKUP = 1_000_000
_MAX_ATTRIBUTES = 1000  # of an element, which lxml finds one after the other
# Files that the shell has opened, for example for <(command).
_OPEN_FILE = re.compile(r'/dev/stdin|/(?:dev|proc/self)/fd/\d+')
_URI = re.compile(r'([A-Za-z][A-Za-z0-9+.-]+):/+(.*)', re.DOTALL)
# Replacements at the beginning of the document.
_DECLARATIONS = (
    (re.compile(rb'\A(<\?xml\s+version\s*=\s*["\'])[\d.]*'), rb'\g<1>1.0'),
    (re.compile(rb'\A<\?xml\s+(?!version)'), b'<?xml version="1.0" '),
)
_START = re.compile(rb'<\?xml[\s?]|<(sdf|robot)[\s>]')
_ROOT = re.compile(rb'<(sdf|robot)(?=[\s>])')
_DECLARED_PREFIX = re.compile(rb'xmlns:([\w.-]+)\s*=')
_USED_PREFIXES = (re.compile(rb'</?([A-Za-z_][\w.-]*):[\w.-]+'),
                  re.compile(rb'\s([A-Za-z_][\w.-]*):[\w.-]+\s*=\s*["\']'))
# A blank for each byte but line feeds.
_BLANKS = bytes(byte if byte == ord('\n') else ord(' ') for byte in range(256))


class DescriptionError(ValueError):
    """A robot description that cannot be read, or cannot be written as asked."""

    def __init__(self, message: str, element: AnyElement | None = None, *, source: str = '',
                 line: int = 0, tag: str = '') -> None:
        """
        Create the message ``source:line: <tag>: message``.

        :param message: the error with the wrong value, and what to do.
        :param element: the element with the error, which has the source, the line and the tag.
        :param source: name of the file, if there is no element.
        """
        if element is not None:
            source = source or source_of(element)
            line, tag = line_of(element), local_name(element)
        elif isinstance(line, SourceLine):
            source = line.source or source
        location = ':'.join(filter(None, [source, str(line) if line else '']))
        super().__init__(': '.join(filter(None, [location, f'<{tag}>' if tag else '', message])))


def source_of(element: AnyElement) -> str:
    """Return the name of the file that an element comes from."""
    return element.getroottree().docinfo.URL or ''


def line_of(element: AnyElement) -> SourceLine:
    """Return the line where an element begins, 0 if it does not come from a file."""
    return SourceLine(element.sourceline or 0, source_of(element))


def local_name(element: AnyElement) -> str:
    """Return the tag of an element without its namespace."""
    return str(element.tag).rpartition('}')[2]


def read_bytes(path: str) -> bytes:
    """
    Read a regular file, or standard input if the path is ``-``.

    :raises DescriptionError: the file cannot be read, or is larger than ``MAX_BYTES``.
    """
    try:
        if path == '-':
            data = sys.stdin.buffer.read(MAX_BYTES + 1)
        elif _OPEN_FILE.fullmatch(path):
            with Path(path).open('rb') as file:
                data = file.read(MAX_BYTES + 1)
        else:
            data = read_regular(Path(path), MAX_BYTES)
    except OSError as err:
        raise DescriptionError(_reason(path, err), source=display_name(path)) from err
    if len(data) > MAX_BYTES:
        raise DescriptionError(f'cannot be read: it is larger than {MAX_BYTES} bytes',
                               source=display_name(path))
    return data


def _reason(path: str, err: OSError) -> str:
    """Return why a file cannot be read, and what to give instead of a URI."""
    uri = _URI.fullmatch(path)
    if not uri:
        return f'cannot be read: {err.strerror}'
    scheme, rest = uri.groups()
    package, _, inside = rest.partition('/')
    instead = {'file': f'give the path /{rest}',
               'package': f'give the path $(ros2 pkg prefix --share {package})/{inside}',
               'model': 'give the path of the file or of the model folder'}
    return (f'cannot be read: URIs of {scheme}: are not supported; '
            + instead.get(scheme.lower(), 'download the file and give its path'))


def display_name(path: str) -> str:
    """Return the name of a file for messages."""
    return '<stdin>' if path == '-' else path


def parse(data: bytes, source: str, report: Report) -> Element:
    """
    Read XML without entities, without network access and with limits of size and depth.

    Errors of the table above are repaired with a warning.

    :param source: name of the file, for messages.
    :returns: the root element.
    :raises DescriptionError: the data is not XML, declares entities or is too large.
    """
    if data.count(b'<') + data.count(b'=') > _MAX_MARKUP:
        raise DescriptionError(f'has more than {_MAX_MARKUP} tags, comments and attributes, the '
                               'limit for a robot description', source=source)
    entity = re.search(rb'<!ENTITY[^>]{0,80}', data)
    if entity:
        raise _entity_error(source, data.count(b'\n', 0, entity.start()) + 1)
    try:
        return _parse(data, source)
    except etree.XMLSyntaxError as err:
        error = err
    document = repaired(data)
    if document is None:
        raise _syntax_error(error, source) from error
    try:
        root = _parse(document, source)
    except etree.XMLSyntaxError as err:
        raise _syntax_error(err, source) from err
    report.warn(local_name(root), '', SourceLine(error.lineno or 0, source),
                f'{_message(error)}; the file is read with this error repaired')
    return root


def repaired(data: bytes) -> bytes | None:
    """Return a document with the errors of the table repaired, or None if it has none of them."""
    start = _START.search(data)
    if start is None:
        return None
    document = data[start.start():]
    for pattern, replacement in _DECLARATIONS:
        document = pattern.sub(replacement, document, count=1)
    document = _without_dashes(document)
    used = {prefix for pattern in _USED_PREFIXES for prefix in pattern.findall(document)}
    prefixes = sorted(used - {*_DECLARED_PREFIX.findall(document), b'xmlns', b'xml'})
    if b'xacro' in prefixes:  # without the namespace of xacro, xacro does not expand the file
        return None
    # The lines of the text that is removed move into the tag of the root element.
    lines = b'\n' * data.count(b'\n', 0, start.start())
    namespaces = b''.join(b' xmlns:%b="urn:undeclared:%b"' % (prefix, prefix)
                          for prefix in prefixes)
    document = _ROOT.sub(lambda tag: tag[0] + lines + namespaces, document, count=1)
    return document if document != data else None


def _without_dashes(document: bytes) -> bytes:
    """Blank the comments that contain ``--``."""
    blanked = bytearray(document)
    start = document.find(b'<!--')
    while start >= 0:
        end = document.find(b'-->', start + 4)
        if end < 0:
            break
        if document.find(b'--', start + 4, end + 1) >= 0:
            blanked[start + 4:end] = document[start + 4:end].translate(_BLANKS)
        start = document.find(b'<!--', end + 3)
    return bytes(blanked)


def _parse(data: bytes, source: str) -> Element:
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False,
                             remove_comments=True, remove_pis=True)
    root = etree.fromstring(data, parser)
    root.getroottree().docinfo.URL = source  # older lxml escapes the argument base_url
    # Some encodings hide the declarations of entities until the data is parsed.
    dtd = root.getroottree().docinfo.internalDTD
    if dtd is not None and any(True for _ in dtd.iterentities()):
        raise _entity_error(source)
    if root.xpath(f'boolean(//*[@*[{_MAX_ATTRIBUTES + 1}]])'):
        raise DescriptionError(f'has an element with more than {_MAX_ATTRIBUTES} attributes, the '
                               'limit for a robot description', source=source)
    return root


def _entity_error(source: str, line: int = 0) -> DescriptionError:
    return DescriptionError('entity declarations are not supported; replace each entity by its '
                            'value', source=source, line=line, tag='!ENTITY')


def _syntax_error(err: etree.XMLSyntaxError, source: str) -> DescriptionError:
    return DescriptionError(_message(err), source=source, line=err.lineno or 0)


def _message(err: etree.XMLSyntaxError) -> str:
    message = str(err.msg).partition('\n')[0]
    if message.startswith('Excessive depth'):
        return 'elements are nested more than 256 deep, the limit for a robot description'
    return f'not well-formed XML: {message}'


def required_name(element: AnyElement) -> str:
    """Return the name of an element that must have one."""
    name = (element.get('name') or '').strip()
    if not name:
        raise DescriptionError('has no name=', element)
    return name


def required_child(element: ElementT, tag: str) -> ElementT:
    """Return a child that an element must have."""
    child = element.find(tag)
    if child is None:
        raise DescriptionError(f'has no <{tag}>', element)
    return child


def required_attribute(element: AnyElement, name: str) -> str:
    """Return an attribute that an element must have."""
    value = element.get(name)
    if value is None:
        raise DescriptionError(f'has no {name}=', element)
    return value


def to_bytes(root: Element) -> bytes:
    """Return an indented document with an XML declaration and without unused namespaces."""
    etree.cleanup_namespaces(root)
    etree.indent(root)
    return b'<?xml version="1.0"?>\n' + etree.tostring(root, encoding='utf-8') + b'\n'
