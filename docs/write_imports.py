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
Write the page ``docs/imports.md`` with pictures of the imports in the code.

Run ``python3 docs/write_imports.py`` after an import between two folders has changed. ``make
docs`` does so too.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).with_name('imports.md')

Graph = Mapping[str, frozenset[str]]

_TEXT = """# Imports

<!-- Written by docs/write_imports.py from the code. Do not edit this page. -->

This page is for those who add an import between two folders.
[Architecture](architecture.md#rules-for-imports) has the rules.

Each folder, or module without a folder, stands above all that it imports. Behind the arrow are its
imports, without those that one of them imports, too.

## Images

```text
{}```

## Robots

In `robot/`, which imports only small modules of the rest:

```text
{}```
"""


@cache
def module_imports() -> Graph:
    """
    Return the modules that each module of the package imports, without those of other packages.

    Modules are paths without suffix, relative to ``opencv_tools/``: ``image/layout``. Imports in
    functions and imports for types count as well.
    """
    package = ROOT / 'opencv_tools'
    sources = {path.relative_to(package).with_suffix('').as_posix(): path
               for path in sorted(package.rglob('*.py')) if path.name != '__init__.py'}
    return {name: frozenset(_imported(path) & sources.keys() - {name})
            for name, path in sources.items()}


def _imported(path: Path) -> set[str]:
    names: set[str] = set()
    for statement in ast.walk(ast.parse(path.read_text())):
        if isinstance(statement, ast.Import):
            names.update(alias.name for alias in statement.names)
        elif isinstance(statement, ast.ImportFrom) and statement.module:
            names.add(statement.module)
            names.update(f'{statement.module}.{alias.name}' for alias in statement.names)
    return {name.removeprefix('opencv_tools.').replace('.', '/') for name in names
            if name.startswith('opencv_tools.')}


def grouped(modules: Graph, group: Callable[[str], str]) -> Graph:
    """Return the imports between groups of modules; a module of the group '' is left out."""
    groups = sorted({group(module) for module in modules} - {''})
    return {name: frozenset(group(other) for module, others in modules.items()
                            if group(module) == name for other in others) - {name, ''}
            for name in groups}


def circles(graph: Graph) -> list[str]:
    """Return the names that import themselves through others, sorted."""
    return sorted(name for name in graph if name in _reached(graph, graph[name]))


def _reached(graph: Graph, starts: frozenset[str]) -> set[str]:
    found: set[str] = set()
    waiting = [*starts]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += graph[name]
    return found


def picture(graph: Graph) -> str:
    """
    Draw a graph without circles as text.

    Each group stands above all groups that it imports. An empty line separates the floors. Behind
    the arrow are its imports, without those that one of them imports, too.
    """
    assert not circles(graph), circles(graph)
    floors: dict[str, int] = {}

    def floor(name: str) -> int:
        if name not in floors:
            floors[name] = 1 + max(map(floor, graph[name]), default=0)
        return floors[name]

    width = max(map(len, graph))
    lines: list[str] = []
    for level in range(max(map(floor, graph)), 0, -1):
        for name in (name for name in graph if floor(name) == level):
            direct = [other for other in sorted(graph[name]) if not any(
                other in _reached(graph, graph[third]) for third in graph[name])]
            lines += _wrapped(f'{name:{width}} -> ', direct) if direct else [name]
        lines.append('')
    return '\n'.join(lines).rstrip() + '\n'


def _wrapped(start: str, names: list[str]) -> list[str]:
    lines = [start + names[0]]
    for name in names[1:]:
        lines[-1] += ','
        if len(lines[-1]) + len(name) > 96:
            lines.append(' ' * (len(start) - 1))
        lines[-1] += f' {name}'
    return lines


def _group_of_images(module: str) -> str:
    folder, _, rest = module.partition('/')
    if folder == 'robot':
        return ''
    part = rest.rpartition('/')[0]
    return f'{folder}/{part}' if folder == 'nodes' and part else folder


def _group_of_robots(module: str) -> str:
    folder, _, rest = module.partition('/')
    return rest.partition('/')[0] if folder == 'robot' else ''


def page() -> str:
    """Return the text of the page with the pictures of today's imports."""
    pictures = (picture(grouped(module_imports(), group))
                for group in (_group_of_images, _group_of_robots))
    return _TEXT.format(*pictures)


if __name__ == '__main__':
    PAGE.write_text(page(), encoding='utf-8')
