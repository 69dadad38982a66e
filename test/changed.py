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
Run the tests that a change reaches: python changed.py [BASE] [arguments for pytest].

Compared with the branch or commit BASE, ``main`` by default. A test file is reached by the modules
and helpers that it imports, and by the executables that it names, directly or through others. Each
other file of the package reaches the tests of its part, or all tests.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from functools import cache
from pathlib import Path
import re
import subprocess
import sys

import pytest

ROOT = Path(__file__).parents[1]
TEST = ROOT / 'test'
#: Marks of the quick tests, as in the Makefile.
QUICK = 'not linter and not thorough'
COMMANDS = ROOT / 'opencv_tools' / 'commands.py'
#: Tests of files that are not imported, by the beginning of their paths. The first match counts.
PARTS = {'docs/': 'test/package', 'README.md': 'test/package', 'CHANGELOG.rst': 'test/package',
         'CONTRIBUTING.md': 'test/package', '.github/': 'test/package', 'urdf/': 'test/unit/robot',
         'sdf/': 'test/unit/robot', 'meshes/': 'test/unit/robot', 'launch/': 'test/package',
         'config/': 'test/package', 'benchmarks/': '', 'test/data/robots/': 'test/unit/robot',
         'opencv_tools/viewer/page/': 'test/unit/viewer',
         'opencv_tools/robot/view/page/': 'test/unit/robot'}


@cache
def commands() -> dict[str, str]:
    """Return the source of each name that commands.py defines."""
    text = COMMANDS.read_text()
    found = {}
    for node in ast.parse(text).body:
        names = [node.name] if isinstance(node, ast.FunctionDef) else [
            target.id for target in getattr(node, 'targets', []) if isinstance(target, ast.Name)]
        found.update({name: ast.get_source_segment(text, node) or '' for name in names})
    return found


def file_of(module: str) -> Path:
    """Return the file of a module of the package or of a helper of the tests."""
    path = Path(*module.split('.')).with_suffix('.py')
    places = [ROOT] if module.startswith('opencv_tools') else [TEST / 'support', TEST]
    return next((place / path for place in places if (place / path).is_file()), Path())


def modules_of(executable: str) -> set[str]:
    """Return the modules that commands.py loads for an executable."""
    found, waiting = set[str](), [executable]
    while waiting:
        name = waiting.pop()
        found.add(name)
        waiting += ({*re.findall(r'\w+', commands()[name])} & commands().keys()) - found
    return {module for name in found
            for module in re.findall(r"'(opencv_tools[\w.]+)'", commands()[name])}


@cache
def imports(path: Path) -> frozenset[Path]:
    """Return the modules and helpers that a file imports, and those of executables it names."""
    names = set[str]()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
            names.update(f'{node.module}.{alias.name}' for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and path != COMMANDS:
            names.update(re.findall(r'opencv_tools\.[\w.]+', node.value))
            for name in {*re.findall(r'\w+', node.value)} & commands().keys():
                names |= {'opencv_tools.commands', *modules_of(name)}
    return frozenset(map(file_of, names)) - {Path(), path}


def closure(path: Path) -> set[Path]:
    """Return a file and all that it imports, directly or through others."""
    found, waiting = set[Path](), [path]
    while waiting:
        file = waiting.pop()
        if file not in found:
            found.add(file)
            waiting += imports(file)
    return found


def reached(changed: Iterable[str], tests: Iterable[Path]) -> list[str]:
    """
    Return the tests that changed files reach, as arguments for pytest.

    :param changed: paths relative to the root of the repository.
    :param tests: the files of tests.
    """
    sources, found = set[Path](), set[str]()
    for name in changed:
        part = next((part for start, part in PARTS.items() if name.startswith(start)), None)
        if part is not None:
            found |= {part} - {''}
        elif name.endswith('.py') and name.startswith(('opencv_tools/', 'test/')):
            sources.add(ROOT / name)
        else:
            return ['test']
    found |= {str(test.relative_to(ROOT)) for test in tests if closure(test) & sources}
    return ['test'] if TEST / 'conftest.py' in sources else sorted(found)


def main() -> int:
    """Return the exit status of pytest; 0 if the change reaches no test, 2 if there is none."""
    base, *arguments = sys.argv[1:] or ['main']

    def git(*words: str) -> list[str]:
        return subprocess.run(['git', '-C', str(ROOT), *words], stdout=subprocess.PIPE, text=True,
                              check=True).stdout.splitlines()

    start, = git('merge-base', base, 'HEAD')
    changed = {*git('diff', '--name-only', start),
               *git('ls-files', '--others', '--exclude-standard')}
    if not changed:
        print(f'nothing differs from {base}: give the commit before the change, such as '
              'make test-changed BASE=origin/main', file=sys.stderr)
        return 2
    tests = [path for folder in ('nodes', 'package', 'unit')
             for path in sorted((TEST / folder).rglob('test_*.py'))]
    selected = reached(changed, tests)
    print(f'{len(changed)} files differ from {base}; they reach',
          ' '.join(selected) or 'no test')
    return pytest.main(['-q', '-m', QUICK, *arguments, *selected]
                       ) if selected else 0


if __name__ == '__main__':
    sys.exit(main())
