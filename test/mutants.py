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
Count the seeded mutants of a module that tests kill: mutants.py MODULE TEST... [--count N].

A mutant is the module with one change: another comparison, operator, number or truth value, or a
statement that is left out. It is killed if a test fails. Living mutants are printed.
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Callable, Iterator
import copy
import os
from pathlib import Path
import random
import shutil
import subprocess
import sys
import tempfile

from changed import QUICK, ROOT

_COPIED = ('opencv_tools', 'test', 'docs', 'urdf', 'sdf', 'meshes', 'examples', 'setup.cfg',
           'setup.py', 'package.xml')
_OPPOSITE: dict[type, type] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn,
    ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.FloorDiv,
    ast.FloorDiv: ast.Mult, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
    ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd, ast.Mod: ast.Mult}
_SECONDS = 120.0


def _changes(node: ast.AST) -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield a name for each change of a node, and a function that makes it."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in _OPPOSITE:
        yield 'comparison', lambda: node.ops.__setitem__(0, _OPPOSITE[type(node.ops[0])]())
    elif isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(node.op) in _OPPOSITE:
        yield 'operator', lambda: setattr(node, 'op', _OPPOSITE[type(node.op)]())
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float, bool):
        new = not node.value if isinstance(node.value, bool) else node.value + 1
        yield 'value', lambda: setattr(node, 'value', new)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield 'not', lambda: setattr(node, 'op', ast.UAdd())
    for name in ('body', 'orelse'):
        for number, line in enumerate(getattr(node, name, ()) if not isinstance(
                node, ast.Module | ast.ClassDef | ast.IfExp | ast.Lambda) else ()):
            if isinstance(line, ast.Raise | ast.AugAssign | ast.Return) or (
                    isinstance(line, ast.Expr) and not isinstance(line.value, ast.Constant)):
                yield 'statement', lambda name=name, number=number: (  # type: ignore[misc]
                    getattr(node, name).__setitem__(number, ast.Pass()))


def _without_effect(tree: ast.AST) -> set[ast.AST]:
    """Return the nodes of annotations, which nothing evaluates."""
    found = [getattr(node, name, None) for node in ast.walk(tree)
             for name in ('annotation', 'returns')]
    return {inner for outer in found if outer for inner in ast.walk(outer)}


def mutants(text: str, count: int, seed: int) -> Iterator[tuple[str, str]]:
    """Yield a description and the source of seeded mutants of a module."""
    tree = ast.parse(text)
    left_out = _without_effect(tree)
    places = [(index, number) for index, node in enumerate(ast.walk(tree)) if node not in left_out
              for number, _ in enumerate(_changes(node))]
    for index, number in random.Random(seed).sample(places, min(count, len(places))):
        mutant = copy.deepcopy(tree)
        node = [*ast.walk(mutant)][index]
        line = getattr(node, 'lineno', 0)
        before = ast.unparse(node).partition('\n')[0]
        kind, change = [*_changes(node)][number]
        change()
        yield f'line {line}, {kind}: {before}', ast.unparse(ast.fix_missing_locations(mutant))


def is_killed(folder: Path, marks: str, tests: list[str]) -> bool:
    """Return whether a test with such marks fails in a copy of the repository."""
    environment = {**os.environ, 'PYTHONPATH': str(folder), 'PYTHONDONTWRITEBYTECODE': '1'}
    try:
        return subprocess.run(
            [sys.executable, '-m', 'pytest', '-x', '-q', '-m', marks, *tests],
            cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            timeout=_SECONDS, check=False).returncode != 0
    except subprocess.TimeoutExpired:
        return True


def main() -> int:
    """Return 0; 1 if the tests fail without a change."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('module', help='path of the module, such as opencv_tools/image/jpeg.py')
    parser.add_argument('tests', nargs='+')
    parser.add_argument('--count', type=int, default=30)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--thorough', action='store_true', help='run the thorough tests as well')
    options = parser.parse_args()
    marks = 'not linter' if options.thorough else QUICK
    text = (ROOT / options.module).read_text()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in _COPIED:
            copied = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
            copied(ROOT / part, folder / part)
        if is_killed(folder, marks, options.tests):
            print('the tests fail without a mutant')
            return 1
        living = []
        for description, source in mutants(text, options.count, options.seed):
            (folder / options.module).write_text(source)
            if not is_killed(folder, marks, options.tests):
                living.append(description)
        print(f'{options.module}: {options.count - len(living)} of {options.count} killed',
              *living, sep='\n  ')
    return 0


if __name__ == '__main__':
    sys.exit(main())
