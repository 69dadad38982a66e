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
Expansion of xacro files with the package xacro.

The expansion evaluates the Python expressions of a file. ``$(find package)`` becomes a
``package://`` URI in meshes, textures and ``<uri>``, because the path of a folder is valid on one
machine only. Plugins do not read such URIs, so it becomes a path in other texts.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout, suppress
import importlib
from io import StringIO
import os
from pathlib import Path
import re
import stat
import sys
from typing import Any
from xml.dom import minidom

from opencv_tools.base.regular_files import describe_kind
from opencv_tools.base.remedies import installation
from opencv_tools.robot.packages import candidate_folders
from opencv_tools.robot.xacro.errors import (
    LocatedBuilder, location_of, one_line, os_error, PACKAGE_MARKER, to_description_error,
    to_text, XacroProblem)
from opencv_tools.robot.xml.document import DescriptionError, parse
from opencv_tools.robot.xml.input import display_name, read_bytes
from opencv_tools.robot.xml.report import Report, SourceLine

_MARKER_URI = re.compile(f'(?:(?i:file:(?://localhost)?)/*)?{PACKAGE_MARKER.pattern}')
# Macros that call each other. The recursion limit of Python is not much higher.
_MAX_DEPTH = 120
_MAX_CALLS = 5000
_PACKAGE = re.compile(r'[\w.-]+')
# Elements with a URI, as their attribute or text.
_URI_HOLDERS = ('mesh', 'texture', 'uri')


def expand(path: str, data: bytes, arguments: Mapping[str, str], report: Report,
           find: str = 'path') -> bytes:
    """
    Expand a xacro file.

    :param path: path of the file, to which includes are relative; ``-`` for standard input.
    :param arguments: values of ``xacro:arg``, by name.
    :param find: ``path`` or ``package``, for ``$(find package)`` in texts other than URIs.
    :returns: XML without xacro.
    :raises DescriptionError: the file cannot be expanded.
    """
    source = display_name(path)
    try:
        patched = _PatchedXacro(report)
    except ImportError as err:
        raise DescriptionError('is a xacro file, but the package xacro is not installed; '
                               f'{installation("xacro")}', source=source
                               ) from err
    values = _Arguments(arguments)
    output = StringIO()  # of the file and of xacro
    with redirect_stdout(output), redirect_stderr(output):
        try:
            document = patched.expand(path, data, values)
            _replace_markers(document, find, report)
        except Exception as err:
            raise to_description_error(err, source) from err
    for line in output.getvalue().splitlines():
        level, colon, message = line.partition(': ')
        if colon and level in ('warning', 'error'):
            report.warn('xacro', '', 0, one_line(message))
    known = ', '.join(sorted(map(repr, values.requested)))
    for name in arguments:
        if name not in values.requested:
            report.warn('xacro:arg', name, 0, 'is not an argument of this file, which has '
                        f'{known or "none"}; it is ignored')
    return to_text(document, source).encode()


class _Arguments(dict[str, str]):
    """Arguments that record which of them a file requests."""

    def __init__(self, values: Mapping[str, str]) -> None:
        super().__init__(values)
        self.requested: set[object] = set()

    def __contains__(self, name: object) -> bool:
        self.requested.add(name)
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.requested.add(name)
        return super().__getitem__(name)


class _PatchedXacro:
    """
    A new import of the package xacro with some functions replaced.

    xacro has no options for these replacements, and keeps the state of an expansion in global
    variables.

    =======================  ======================================================================
    function                 purpose of the replacement
    =======================  ======================================================================
    ``parse``                applies the limits of `xml.document.parse` to included files, refuses
                             include cycles, and records the line of each element
    ``abs_filename_spec``    finds packages by environment variables too, and refuses pipes and
                             devices
    ``handle_macro_call``    limits the depth and the number of macro calls
    ``_eval_find``           marks ``$(find package)``, so that it can become a URI
    =======================  ======================================================================
    """

    def __init__(self, report: Report) -> None:
        for name, module in [*sys.modules.items()]:
            if module and name.partition('.')[0] == 'xacro':
                del sys.modules[name]
        xacro: Any = importlib.import_module('xacro')
        self._xacro = xacro
        self._report = report
        self._original = dict(vars(xacro))
        self._calls = 0
        xacro.parse, xacro.abs_filename_spec = self._parse, self._path
        xacro.handle_macro_call = self._call_macro
        substitution: Any = importlib.import_module('xacro.substitution_args')
        substitution._eval_find = substitution._eval_dict['find'] = _find

    def expand(self, path: str, data: bytes, arguments: dict[str, str]) -> minidom.Document:
        self._xacro.init_stacks(None if path == '-' else path)
        document = self._document(data, display_name(path))
        self._xacro.process_doc(document, mappings=arguments, verbosity=0)
        return document

    def _document(self, data: bytes, source: str) -> minidom.Document:
        parse(data, source, self._report)  # refuses what is not safe to parse
        return LocatedBuilder(source).parseString(data)

    def _parse(self, _: object, filename: str) -> minidom.Document:
        """Parse an included file."""
        stack = self._xacro.filestack
        path = os.path.normpath(filename)
        including = [os.path.realpath(file) for file in stack[:-1] if file is not None]
        if os.path.realpath(path) in including:
            raise XacroProblem(f'file {path!r} includes itself'
                               + (' through other files' if len(stack) > 2 else ''))
        try:
            data = read_bytes(path)
        except DescriptionError as err:
            # xacro ignores this error if the include is optional.
            stack.pop()
            raise self._xacro.XacroException(f'file {path!r} cannot be read',
                                             exc=os_error(err)) from err
        return self._document(data, path)

    def _path(self, name: str) -> str:
        """Return the path of a file to include or to read as YAML."""
        start = Path(self._xacro.filestack[-1] or '<stdin>')
        name = PACKAGE_MARKER.sub(lambda marker: _package_folder(marker[1], start), name)
        path = str(self._original['abs_filename_spec'](name))
        self._report.files.append(path)
        with suppress(OSError, ValueError):
            mode = Path(path).stat().st_mode
            if not stat.S_ISDIR(mode) and (kind := describe_kind(mode)):
                raise XacroProblem(f'file {path!r} is {kind}; only regular files are read')
        return path

    def _call_macro(self, node: minidom.Element, macros: object, symbols: object) -> object:
        if not node.tagName.startswith('xacro:'):
            return False
        if len(self._xacro.macrostack) > _MAX_DEPTH:
            raise RecursionError
        self._calls += 1
        if self._calls > _MAX_CALLS:
            raise XacroProblem(f'more than {_MAX_CALLS} macro calls, the limit for a robot '
                               'description')
        return self._original['handle_macro_call'](node, macros, symbols)


def _find(package: str) -> str:
    """Return a marker for the folder of a package."""
    if not _PACKAGE.fullmatch(package):
        raise XacroProblem(f'$(find {package}) is not the name of a package')
    return f'/\ue000{package}\ue001'


def _package_folder(package: str, start: Path) -> str:
    """Return the folder of a package; without a workspace one above a file that names it."""
    for folder in candidate_folders(package, start):
        if folder.is_dir():
            return str(folder)
    raise XacroProblem(f'package {package!r} of $(find {package}) is not found; source its '
                       'workspace, or add it to AMENT_PREFIX_PATH or ROS_PACKAGE_PATH')


def _replace_markers(document: minidom.Document, find: str, report: Report) -> None:
    """Replace the markers: by URIs in meshes, textures and ``<uri>``, else as ``find`` says."""
    for element in document.getElementsByTagName('*'):
        for child in element.childNodes:
            if isinstance(child, minidom.Text):
                child.data = _replaced(child.data, element, find, report)
        for name, value in list(element.attributes.items()):
            if PACKAGE_MARKER.search(value):
                element.setAttribute(name, _replaced(value, element, find, report))


def _replaced(text: str, element: minidom.Element, find: str, report: Report) -> str:
    """Return a text of an element without markers, and report what is not a URI in URDF or SDF."""
    if element.tagName in _URI_HOLDERS:
        return _MARKER_URI.sub(r'package://\1', text)
    source, line = location_of(element)

    def place(marker: re.Match[str]) -> str:
        package, written, reason = marker[1], f'package://{marker[1]}', 'as --find package says'
        if find == 'path':
            try:
                folder = _package_folder(package, Path(source))
                written = PACKAGE_MARKER.sub(lambda _: folder, marker[0])
                reason = 'which is valid on this machine only; --find package writes a URI'
            except XacroProblem:
                reason = ('because the package is not found; source its workspace, or add it to '
                          'AMENT_PREFIX_PATH')
        report.warn(element.tagName, element.getAttribute('name'), SourceLine(line, source),
                    f'$(find {package}) is written as {written}, {reason}')
        return written

    return _MARKER_URI.sub(place, text)
