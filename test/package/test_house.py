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

"""Size of the modules, circles of imports, and the pictures of the imports."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from functools import cache
import importlib.util
import io
from pathlib import Path
import re
import tokenize
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = {path.relative_to(ROOT).as_posix(): path.read_text()
           for path in sorted((ROOT / 'opencv_tools').rglob('*.py'))}
_GIVES = re.compile(
    r'add_waitable|add_\w+_parameters_callback|watch_parameters|receive_frames|start|start_thread|'
    r'create_(\w+_)?(guard_condition|service|subscription|timer)')
#: Code lines that a room may have: a number grows only by what another room gave back.
BUDGET = {
    '': 1230, 'bags': 1130, 'calibration': 1760, 'capture': 2010, 'convert': 310,
    'datasets': 2270, 'frames': 410, 'image': 1150, 'message_types': 370, 'nodes': 2530,
    'recording': 2080, 'robot': 6330, 'topics': 1810, 'transport': 1160, 'video': 880,
    'viewer': 5420}
NO_CODE = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
           tokenize.ENDMARKER)
#: A description has one of these, or it repeats the name.
KNOWS = re.compile(
    r"[0-9`'\"();,:<>=/*]|\b(all|as|at|before|by|after|bytes?|degrees?|each|else|empty|every|for|from|"
    r'first|if|instead|kg|last|lines?|lower|may|metres?|ms|must|nanoseconds?|newest|no|None|not|Hz|'
    r'oldest|only|or|order|ordered|other|parts?|per|pixels?|radians?|relative|absolute|same|seconds?|'
    r'sorted|that|to|units?|unless|until|upper|when|where|whether|which|while|with|without)\b')
_LICENCE_END = 'limitations under the License.\n'


def _load_write_imports() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        'write_imports', ROOT / 'docs' / 'write_imports.py')
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


WRITE_IMPORTS = _load_write_imports()


@cache
def _tree(path: str) -> ast.AST:
    return ast.parse(SOURCES[path])


def nodes_of(kind: type | tuple[type, ...]) -> Iterator[tuple[str, ast.AST]]:
    """Yield each definition of a kind with a name for it: ``file:name``."""
    for path in SOURCES:
        for node in ast.walk(_tree(path)):
            if isinstance(node, kind):
                yield f'{path}:{getattr(node, "name", "")}', node


def functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    for name, node in nodes_of((ast.FunctionDef, ast.AsyncFunctionDef)):
        assert isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        yield name, node


def code_lines(path: str) -> int:
    """Return the number of lines without licence, docstrings, comments, imports and blank ones."""
    tokens = tokenize.generate_tokens(io.StringIO(SOURCES[path]).readline)
    lines = {number for token in tokens if token.type not in NO_CODE
             for number in range(token.start[0], token.end[0] + 1)}
    for node in ast.walk(_tree(path)):
        body = getattr(node, 'body', None)
        text = body[0] if isinstance(body, list) and body else None
        is_text = isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
        removed = node if isinstance(node, ast.Import | ast.ImportFrom) else (
            text if is_text else None)
        if removed is not None:
            lines -= {*range(removed.lineno, (removed.end_lineno or 0) + 1)}
    return len(lines)


def test_code_lines_by_room() -> None:
    rooms: Counter[str] = Counter()
    for path in SOURCES:
        _, *folder, _ = path.split('/')
        rooms[folder[0] if folder else ''] += code_lines(path)
    assert {room: lines for room, lines in rooms.items() if lines > BUDGET.get(room, 0)} == {}
    assert sum(BUDGET.values()) - sum(rooms.values()) < 300, 'take what a room gave back off'


def test_parameters_are_described_by_more_than_their_name() -> None:
    empty = [f'{path}: {text[0].strip()}' for path, source in SOURCES.items()
             for text in re.finditer(r'^( *):param \w+: (.*)$(?!\n\1 )', source, re.MULTILINE)
             if not KNOWS.search(text[2].rstrip('.'))]
    assert empty == [], 'leave them out, or add a unit, a range or what a special value means'


def test_modules_have_at_most_500_lines() -> None:
    assert {path: text.count('\n') for path, text in SOURCES.items()
            if text.count('\n') > 500} == {}


def test_page_of_the_viewer_has_at_most_3000_lines() -> None:
    # Without the heads with the licence. Pages of their own do not count.
    texts = [path.read_text() for path in (ROOT / 'opencv_tools' / 'viewer' / 'page').iterdir()
             if not path.name.startswith(('calibrate', 'token'))]
    assert len(texts) > 10
    lines = [text.rpartition(_LICENCE_END)[2].count('\n') for text in texts]
    assert sum(lines) <= 3000


def test_functions_have_at_most_50_lines() -> None:
    lengths = {name: (node.end_lineno or 0) - node.lineno + 1 for name, node in functions()}
    assert len(lengths) > 1000
    assert {name: length for name, length in lengths.items() if length > 50} == {}


def test_class_names_occur_once() -> None:
    files: dict[str, list[str]] = {}
    for name, _ in nodes_of(ast.ClassDef):
        path, _, name = name.partition(':')
        if not name.startswith('_'):
            files.setdefault(name, []).append(path)
    assert {name: paths for name, paths in files.items() if len(paths) > 1} == {}


def test_few_signatures_have_more_than_6_parameters() -> None:
    long = {}
    for name, node in functions():
        names = [one.arg for one in (
            *node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
        count = len(names) - (names[:1] in (['self'], ['cls']))
        if count > 6:
            long[name] = count
    assert len(long) <= 5, long


def test_few_classes_have_more_than_12_methods() -> None:
    large = {}
    for name, node in nodes_of(ast.ClassDef):
        count = sum(isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef)
                    for one in ast.iter_child_nodes(node))
        if count > 12:
            large[name] = count
    assert len(large) <= 8, large


def test_few_modules_import_more_than_10_of_ours() -> None:
    # A module of one noun has few imports, but one that composes many nouns needs each of them.
    graph = WRITE_IMPORTS.module_imports()
    many = {name: len(others) for name, others in graph.items() if len(others) > 10}
    assert len(many) <= 45, many


def test_imports_have_no_circle() -> None:
    graph = WRITE_IMPORTS.module_imports()
    assert len(graph) > 100
    assert WRITE_IMPORTS.circles(graph) == []


def test_circle_is_found() -> None:
    graph = {'a': frozenset('b'), 'b': frozenset('c'), 'c': frozenset('b'), 'd': frozenset()}
    assert WRITE_IMPORTS.circles(graph) == ['b', 'c']


def late_attributes(text: str) -> list[str]:
    """Return the attributes that constructors set after they gave a callback to an executor."""
    late = []
    for method in ast.walk(ast.parse(text)):
        if not isinstance(method, ast.FunctionDef) or method.name != '__init__':
            continue
        is_given = False
        for statement in method.body:
            nodes = [*ast.walk(statement)]
            later = [inner for node in nodes if isinstance(node, ast.Lambda)
                     for inner in ast.walk(node)]
            gives = '_NeverExecuted' not in ast.unparse(statement) and any(
                isinstance(node, ast.Call) and node not in later
                and _GIVES.fullmatch(ast.unparse(node.func).rpartition('.')[2]) for node in nodes)
            if is_given and not gives:
                late += [node.attr for node in nodes if isinstance(node, ast.Attribute)
                         and isinstance(node.ctx, ast.Store)]
            is_given |= gives
    return late


def test_constructors_give_callbacks_to_an_executor_last() -> None:
    paths = [*(ROOT / 'opencv_tools').rglob('*.py'), *(ROOT / 'examples').rglob('*.py')]
    late = {path.name: late_attributes(path.read_text()) for path in paths}
    assert {name: names for name, names in late.items() if names} == {}


@pytest.mark.parametrize('statement', [
    'node.create_timer(1, self.f)', 'self.w = node.add_waitable(self)', 'thread.start()',
    'self.s = node.receive_frames("t", self.f) if node else None'])
def test_late_attribute_is_found(statement: str) -> None:
    lines = ['class A:', ' def __init__(self):', '  self.a = 1', f'  {statement}', '  self.b = 2']
    assert late_attributes('\n'.join(lines)) == ['b']
    assert late_attributes('\n'.join([*lines[:2], *lines[4:], lines[3]])) == []


def test_picture_of_a_graph() -> None:
    graph = {'low': frozenset(), 'a': frozenset({'low'}), 'b': frozenset({'low', 'a'}),
             'alone': frozenset()}
    assert WRITE_IMPORTS.picture(graph) == 'b     -> a\n\na     -> low\n\nlow\nalone\n'


def test_threads_and_locks_are_on_the_page() -> None:
    page = WRITE_IMPORTS.PAGE.read_text()
    threads, locks = set(), set()
    for path, text in SOURCES.items():
        threads |= {*re.findall(r"Thread\(.*?name=f?'([a-z ]+)", text, re.DOTALL),
                    *re.findall(r"ThreadPoolExecutor\(\w+, '(\w+)'", text)}
        owner = ''
        for line in text.splitlines():
            owner = (re.match(r'class (\w+)', line) or ['', owner])[1]
            lock = re.search(r'(\w+) = (?:\w+\.)?(?:Lock|RLock|Condition)\(\)', line)
            if lock:
                locks.add(f'{owner if line[0] == " " else Path(path).stem}.{lock[1]}')
    assert len(threads) > 6 and len(locks) > 10
    assert [name for name in sorted(threads) if f'| `{name}' not in page] == []
    table = page.partition('| lock | held by |')[2].partition('\n\n')[0]
    assert sorted(re.findall(r'^\| `(.*?)` \|', table, re.MULTILINE)) == sorted(locks)


def test_pictures_of_the_imports_are_up_to_date() -> None:
    assert WRITE_IMPORTS.PAGE.read_text() == WRITE_IMPORTS.page(), (
        'the imports in docs/architecture.md are not those of the code: run '
        'python3 docs/write_imports.py')
    assert WRITE_IMPORTS.PAGE.read_text().count('written by docs/write_imports.py') == 2
