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

"""Documents of XML: robot descriptions, read safely and repaired, their elements and errors."""

from __future__ import annotations

from contextlib import suppress
from copy import deepcopy
import re
from typing import overload, TypeVar

from lxml import etree
from opencv_tools.robot.xml.report import Report, SourceLine

# Errors of files of others that libxml2 recovers from without losing anything: a declaration that
# is not first, other versions in it, and prefixes without a namespace.
_RECOVERED = frozenset({
    'ERR_RESERVED_XML_NAME', 'ERR_UNKNOWN_VERSION', 'ERR_VERSION_MISSING',
    'NS_ERR_UNDEFINED_NAMESPACE'})
_COMMENT = re.compile(rb'(?<=<!--).*?(?=-->)', re.DOTALL)
_START = re.compile(rb'<\?xml[\s?]|<(sdf|robot)[\s>]')
_ROOT = re.compile(rb'<(sdf|robot)(?=[\s>])')
_UNDECLARED = re.compile('Namespace prefix ([^ ]+) ')
# A blank for each byte but line feeds.
_BLANKS = bytes(byte if byte == ord('\n') else ord(' ') for byte in range(256))
Element = etree._Element

# Marks an unread element that the reader found. Its value is TEXT_READ if the text was read.
PARTLY_READ = '{urn:opencv_tools:preserved}part'
TEXT_READ = 'text'
# Largest number of tags, attributes and comments. It bounds memory and time.
_MAX_MARKUP = 1_000_000
_MAX_ATTRIBUTES = 1000  # of an element, which lxml finds one after the other


class TrackedElement:
    """
    An element that records which attributes, texts and children a reader consumed.

    Reading an attribute or a text consumes it. A child from `find` keeps its unread parts in this
    element; a child from `take_first` or `take_all` has its own. The XML is never changed.
    """

    __slots__ = ('_children', '_is_taken', '_names', 'element')

    def __init__(self, element: Element) -> None:
        self.element = element  # reading from it consumes nothing
        self._names: set[str] = set()  # consumed attributes; '' is the text
        self._children: dict[Element, TrackedElement] = {}
        self._is_taken = True  # whether its unread parts are its own, not its parent's

    @property
    def tag(self) -> str:
        """Tag of the element."""
        return str(self.element.tag)

    @property
    def text(self) -> str | None:
        """Text of the element; reading consumes it."""
        self._names.add('')
        return self.element.text

    def __contains__(self, name: str) -> bool:
        # This does not consume the attribute.
        return name in self.element.attrib

    @overload
    def get(self, name: str) -> str | None: ...
    @overload
    def get(self, name: str, default: str) -> str: ...

    def get(self, name: str, default: str | None = None) -> str | None:
        """Return an attribute and consume it."""
        value = self.element.get(name)
        if value is None:
            return default
        self._names.add(name)
        return value

    def find(self, tag: str) -> TrackedElement | None:
        """Return the first child with a tag; its unread parts stay those of this element."""
        child = next(self.element.iterchildren(tag), None)
        return None if child is None else self._child(child)

    def findtext(self, tag: str) -> str | None:
        """Return the text of the first child with a tag, and consume it."""
        child = self.find(tag)
        return None if child is None else child.text or ''

    def take_first(self, tag: str) -> TrackedElement | None:
        """Return the first child with a tag and consume it; its unread parts are its own."""
        child = next(self.element.iterchildren(tag), None)
        return None if child is None else self._child(child, take=True)

    def take_all(self, *tags: str) -> list[TrackedElement]:
        """Return the children with certain tags and consume them; unread parts are their own."""
        return [self._child(child, take=True) for child in self.element.iterchildren(*tags)]

    def put_back(self, child: TrackedElement) -> None:
        """Mark a child as not consumed."""
        self._children.pop(child.element, None)

    def unread(self) -> Element | None:
        """
        Return a copy of the element with its unread parts only; None if everything was read.

        Children from `find` have the attribute ``PARTLY_READ``, even if nothing of them was read:
        the reader has an object for them, so the writer writes them again. A child of which
        everything was read stays without attributes before an unread child with its tag, which
        would take its place otherwise. A text of one word stays: it is the same in all frames.
        """
        element, names = self.element, self._names
        children = []
        read: dict[str, Element] = {}
        for child in element:
            tracked = self._children.get(child)
            if tracked is None:
                if (first := read.pop(str(child.tag), None)) is not None:
                    words = (first.text or '').split()
                    children.append(etree.Element(child.tag, {PARTLY_READ: TEXT_READ}))
                    children[-1].text = words[0] if len(words) == 1 else ''
                children.append(detached(child))
            elif not tracked._is_taken and (unread := tracked.unread()) is not None:
                children.append(unread)
            elif not tracked._is_taken:
                read[str(child.tag)] = child
        attributes = {str(name): str(value) for name, value in element.attrib.items()
                      if name not in names and name != PARTLY_READ}
        text = '' if '' in names else (element.text or '').strip()
        if self._is_taken:  # only taken children are read again; a robot has many children
            self._children = {child: tracked for child, tracked in self._children.items()
                              if tracked._is_taken}
        if not (children or attributes or text):
            return None
        if not self._is_taken:
            attributes[PARTLY_READ] = (
                TEXT_READ if '' in names else element.get(PARTLY_READ, 'true'))
        copy = etree.Element(element.tag, attributes, nsmap=element.nsmap)
        # For messages.
        copy.sourceline = element.sourceline or 0  # type: ignore[misc]
        copy.getroottree().docinfo.URL = element.getroottree().docinfo.URL
        copy.text = text or None
        copy.extend(children)
        return copy

    def _child(self, child: Element, *, take: bool = False) -> TrackedElement:
        tracked = self._children.get(child)
        if tracked is None:
            tracked = self._children[child] = TrackedElement(child)
            tracked._is_taken = False
        tracked._is_taken |= take
        return tracked


def detached(element: Element) -> Element:
    """Return a copy of an element without the text that follows it."""
    copy = deepcopy(element)
    copy.tail = None
    return copy


AnyElement = Element | TrackedElement
ElementT = TypeVar('ElementT', Element, TrackedElement)


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


def _plain(element: AnyElement) -> Element:
    return element.element if isinstance(element, TrackedElement) else element


def source_of(element: AnyElement) -> str:
    """Return the name of the file that an element comes from."""
    return _plain(element).getroottree().docinfo.URL or ''


def line_of(element: AnyElement) -> SourceLine:
    """Return the line where an element begins, 0 if it does not come from a file."""
    return SourceLine(_plain(element).sourceline or 0, source_of(element))


def local_name(element: AnyElement) -> str:
    """Return the tag of an element without its namespace."""
    return str(element.tag).rpartition('}')[2]


def parse(data: bytes, source: str, report: Report) -> Element:
    """
    Read XML without entities, without network access and with limits of size and depth.

    Errors of some kinds are repaired with a warning.

    :param source: name of the file, for messages.
    :returns: the root element.
    :raises DescriptionError: the data is not XML, declares entities or is too large.
    """
    report.files.append(source)
    if data.count(b'<') + data.count(b'=') > _MAX_MARKUP:
        raise DescriptionError(f'has more than {_MAX_MARKUP} tags, comments and attributes, the '
                               'limit for a robot description', source=source)
    entity = re.search(rb'<!ENTITY[^>]{0,80}', data)
    if entity:
        raise _entity_error(source, data.count(b'\n', 0, entity.start()) + 1)
    try:
        return _checked(etree.fromstring(data, _parser()), source)
    except etree.XMLSyntaxError as err:
        error = err
    start = _START.search(data)
    root = None
    if start:
        document = _COMMENT.sub(lambda comment: comment[0].translate(_BLANKS) if (
            b'--' in comment[0] or comment[0][-1:] == b'-') else comment[0], data[start.start():])
        root = _recovered(data[:start.start()].translate(_BLANKS) + document, source)
    if root is None:
        raise _syntax_error(error.msg, error.lineno, source) from error
    report.warn(local_name(root), '', SourceLine(error.lineno or 0, source),
                f'{_message(error.msg)}; the file is read with this error repaired')
    return root


def _recovered(data: bytes, source: str, *, is_declared: bool = False) -> Element | None:
    """
    Return the root of a document in spite of its errors; None if a prefix cannot be declared.

    :param is_declared: whether the root declares the prefixes that had no namespace.
    :raises DescriptionError: something would be lost.
    """
    parser = _parser(recover=True)
    root: Element | None = None
    with suppress(etree.XMLSyntaxError):  # of old versions, as of an unknown encoding
        root = etree.fromstring(data, parser)
    errors = parser.error_log
    known = _RECOVERED | ({'ERR_SPACE_REQUIRED'} if any(
        error.type_name == 'ERR_VERSION_MISSING' for error in errors) else set())
    for error in errors:
        if error.type_name not in known:
            raise _syntax_error(error.message, error.line, source)
    prefixes = {match[1] for error in errors if (match := _UNDECLARED.match(error.message))}
    if root is not None and not prefixes:
        return _checked(root, source)
    if root is None or is_declared or 'xacro' in prefixes:  # xacro would not expand the file
        return None
    declared = ''.join(f' xmlns:{prefix}="urn:undeclared:{prefix}"' for prefix in sorted(prefixes))
    data = _ROOT.sub(lambda tag: tag[0] + declared.encode(), data, count=1)
    return _recovered(data, source, is_declared=True)


def _parser(*, recover: bool = False) -> etree.XMLParser:
    return etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False,
                           remove_comments=True, remove_pis=True, recover=recover)


def _checked(root: Element, source: str) -> Element:
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


def _syntax_error(text: str | None, line: int | None, source: str) -> DescriptionError:
    return DescriptionError(_message(text), source=source, line=line or 0)


def _message(text: str | None) -> str:
    message = str(text).partition('\n')[0]
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
