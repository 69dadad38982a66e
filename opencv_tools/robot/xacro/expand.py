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
Files of xacro, expanded by the package of that name.

Expanding evaluates the Python expressions of a file. Whatever it finds wrong comes out as one
sentence, and ``$(find package)`` as a URI, because a path of one machine helps no other one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
import importlib
from io import StringIO
import os
from pathlib import Path
import re
import stat
from typing import Any
from xml.dom import minidom

from lxml import etree
from opencv_tools.regular_files import describe_kind
from opencv_tools.robot.xacro.document import place_of, PlacedBuilder, text_of
from opencv_tools.robot.xacro.errors import (
    one_line, os_error, PACKAGE_MARKER, sentence, XacroProblem)
from opencv_tools.robot.xml.document import (
    DescriptionError, display_name, Element, parse, read_bytes)
from opencv_tools.robot.xml.report import Report, SourceLine

_XACRO = re.compile(r'https?://(?:www\.|wiki\.)?ros\.org/(?:wiki/)?xacro/?')
_FOUND_URI = re.compile(f'(?i:file:(?://localhost)?)/*{PACKAGE_MARKER.pattern}')
# Of macros that call each other; Python's own limit is not much above.
_DEEPEST = 120
_MOST_CALLS = 5000
_PACKAGE = re.compile(r'[\w.-]+')


def is_xacro(root: Element) -> bool:
    """Tell whether a file declares the namespace of xacro anywhere."""
    return any(namespace and _XACRO.fullmatch(namespace[1])
               for _, namespace in etree.iterwalk(root, events=('start-ns',)))


def expand(path: str, data: bytes, arguments: Mapping[str, str], report: Report) -> bytes:
    """
    Expand a file of xacro.

    :param path: the file, which its includes are relative to; ``-`` for standard input.
    :param data: what it contains.
    :param arguments: of ``xacro:arg``, by name.
    :returns: XML with no more of xacro in it.
    :raises DescriptionError: it cannot be expanded.
    """
    try:
        xacro = importlib.import_module('xacro')
    except ImportError as err:
        raise DescriptionError('is xacro, and the package xacro is not installed '
                               '(apt install ros-jazzy-xacro, or pip install xacro)',
                               source=display_name(path)) from err
    values = _Arguments(arguments)
    said = StringIO()
    # A file's own messages and xacro's go to the terminal at once otherwise.
    with _reset(xacro), redirect_stdout(said), redirect_stderr(said):
        expansion = _Expansion(xacro, report)
        expansion.install()
        xacro.init_stacks(None if path == '-' else path)
        try:
            document = expansion.dom(data, display_name(path))
            xacro.process_doc(document, mappings=values, verbosity=0)
            expanded = _with_uris(document, display_name(path), report)
        except Exception as err:
            raise sentence(err, display_name(path)) from err
    for line in said.getvalue().splitlines():
        level, colon, message = line.partition(': ')
        if colon and level in ('warning', 'error'):
            report.warn('xacro', '', 0, one_line(message))
    known = ', '.join(sorted(map(repr, values.asked)))
    for name in arguments:
        if name not in values.asked:
            report.warn('xacro:arg', name, 0, 'is no argument of this file, which has '
                        f'{known or "none"}; it is ignored')
    return expanded


class _Arguments(dict[str, str]):
    """Arguments that know which of them a file has asked for."""

    def __init__(self, values: Mapping[str, str]) -> None:
        super().__init__(values)
        self.asked: set[object] = set()

    def __contains__(self, name: object) -> bool:
        self.asked.add(name)
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked.add(name)
        return super().__getitem__(name)


@contextmanager
def _reset(xacro: Any) -> Iterator[None]:
    """Put back everything that an expansion changes in the package."""
    substitution: Any = importlib.import_module('xacro.substitution_args')
    names = ('abs_filename_spec', 'filestack', 'handle_macro_call', 'macrostack', 'parse',
             'verbosity')
    kept = {name: getattr(xacro, name) for name in names}
    find, finds = substitution._eval_find, dict(substitution._eval_dict)
    context, includes = dict(xacro.substitution_args_context), list(xacro.all_includes)
    try:
        yield
    finally:
        for name, value in kept.items():
            setattr(xacro, name, value)
        substitution._eval_find = find
        substitution._eval_dict.clear()
        substitution._eval_dict.update(finds)
        xacro.substitution_args_context.clear()
        xacro.substitution_args_context.update(context)
        xacro.all_includes[:] = includes


class _Expansion:
    """What takes the place of functions of xacro while a file is expanded."""

    def __init__(self, xacro: Any, report: Report) -> None:
        self._xacro = xacro
        self._report = report
        self._spec, self._call = xacro.abs_filename_spec, xacro.handle_macro_call
        self._calls = 0

    def install(self) -> None:
        """Put them there."""
        substitution: Any = importlib.import_module('xacro.substitution_args')
        self._xacro.abs_filename_spec = self._file
        self._xacro.parse = self._parse
        self._xacro.handle_macro_call = self._called
        substitution._eval_find = _find
        substitution._eval_dict['find'] = _find

    def dom(self, data: bytes, source: str) -> minidom.Document:
        """
        Parse as xacro does, once it is known to be harmless.

        :raises DescriptionError: it is not XML, or declares entities.
        """
        parse(data, source, self._report)
        return PlacedBuilder(source).parseString(data)

    def _file(self, name: str) -> str:
        """Name a file that is included, or read as YAML; but none that has no end."""
        path = str(self._spec(PACKAGE_MARKER.sub(lambda found: _folder(found[1]), name)))
        with suppress(OSError, ValueError):
            mode = Path(path).stat().st_mode
            if not stat.S_ISDIR(mode) and (kind := describe_kind(mode)):
                raise XacroProblem(f'file {path!r} is {kind}; only regular files are read')
        return path

    def _called(self, node: minidom.Element, macros: object, symbols: object) -> object:
        """Expand a macro, unless a few of them have called each other too often."""
        if not node.tagName.startswith('xacro:'):
            return False
        if len(self._xacro.macrostack) > _DEEPEST:
            raise RecursionError
        self._calls += 1
        if self._calls > _MOST_CALLS:
            raise XacroProblem(f'more than {_MOST_CALLS} macros are called, which no robot needs')
        return self._call(node, macros, symbols)

    def _parse(self, _: object, filename: str) -> minidom.Document:
        """Parse a file that is included."""
        stack = self._xacro.filestack
        path = os.path.normpath(filename)
        above = [os.path.realpath(other) for other in stack[:-1] if other is not None]
        if os.path.realpath(path) in above:
            raise XacroProblem(f'file {path!r} includes itself'
                          + (', by way of others' if len(stack) > 2 else ''))
        try:
            data = read_bytes(path)
        except DescriptionError as err:
            # As xacro has it, so that optional files may be missing.
            stack.pop()
            raise self._xacro.XacroException(f'file {path!r} is not there or cannot be read',
                                             exc=os_error(err)) from err
        return self.dom(data, path)


def _find(package: str) -> str:
    """Stand in for the folder of a package."""
    if not _PACKAGE.fullmatch(package):
        raise XacroProblem(f'$(find {package}) names no package')
    return f'/\ue000{package}\ue001'


def _folder(package: str) -> str:
    """
    Give the real folder of a package.

    :raises XacroProblem: it is not installed.
    """
    try:
        index: Any = importlib.import_module('ament_index_python.packages')
        return str(index.get_package_share_directory(package))
    except (ImportError, LookupError, OSError, ValueError):
        pass
    for folder in _candidates(package):
        if folder.is_dir():
            return str(folder)
    raise XacroProblem(f'package {package!r} of $(find {package}) is not there; '
                       'source the workspace '
                  'that has it, or put it on AMENT_PREFIX_PATH or ROS_PACKAGE_PATH')


def _candidates(package: str) -> Iterator[Path]:
    for prefix in filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)):
        yield Path(prefix) / 'share' / package
    for entry in filter(None, os.environ.get('ROS_PACKAGE_PATH', '').split(os.pathsep)):
        folder = Path(entry)
        if folder.name == package:
            yield folder
        yield folder / package
        yield from sorted(folder.glob(f'*/{package}'))


def _with_uris(document: minidom.Document, source: str, report: Report) -> bytes:
    """Write a document, with the folders of packages as URIs."""
    text = _FOUND_URI.sub(r'package://\1', text_of(document, source))
    if PACKAGE_MARKER.search(text):
        _warn_of_paths(document, report)
    return PACKAGE_MARKER.sub(r'package://\1', text).encode()


def _warn_of_paths(document: minidom.Document, report: Report) -> None:
    """Say where something other than a URI was to be a path."""
    for element in document.getElementsByTagName('*'):
        texts = [child.data for child in element.childNodes if child.nodeType == child.TEXT_NODE]
        if element.tagName not in ('mesh', 'texture'):
            texts += [value for _, value in element.attributes.items()]
        for found in PACKAGE_MARKER.finditer(_FOUND_URI.sub('', ' '.join(texts))):
            source, line = place_of(element)
            report.warn(element.tagName, element.getAttribute('name'), SourceLine(line, source),
                        f'$(find {found[1]}) is written as package://{found[1]}, because the path '
                        'is one of this machine')
