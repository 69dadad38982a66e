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
from collections.abc import Mapping
from dataclasses import dataclass, field
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
    '': 978, 'bags': 1364, 'base': 653, 'calibration': 1781, 'capture': 2493, 'convert': 438,
    'datasets': 3149, 'frames': 449, 'image': 1376, 'message_types': 559, 'nodes': 2827,
    'recording': 2369, 'robot': 6331, 'topics': 1898, 'transport': 1185, 'video': 1043, 'viewer':
    5477}
NO_CODE = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
           tokenize.ENDMARKER)
#: A description has one of these, or it repeats the name.
KNOWS = re.compile(
    r"[0-9`'\"();,:<>=/*]|\b(absolute|all|as|at|before|by|after|bytes?|degrees?|each|else|empty|"
    r'every|first|for|from|Hz|if|instead|kg|last|lines?|lower|may|metres?|ms|must|nanoseconds?|'
    r'newest|no|None|not|oldest|only|or|order|ordered|other|parts?|per|pixels?|radians?|relative|'
    r'same|seconds?|sorted|that|to|units?|unless|until|upper|when|where|whether|which|while|with|'
    r'without)\b')
_LICENCE_END = 'limitations under the License.\n'
_TYPED = re.compile(r'^ */\*\*(?:(?!\*/)[\s\S])*@(?:(?!\*/)[\s\S])*\*/\n', re.MULTILINE)


def _load_write_imports() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        'write_imports', ROOT / 'docs' / 'write_imports.py')
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


WRITE_IMPORTS = _load_write_imports()


@dataclass
class Facts:
    """What the tests know of the definitions of some sources, each by ``file:name``."""

    lengths: dict[str, int] = field(default_factory=dict)
    parameters: dict[str, int] = field(default_factory=dict)
    methods: dict[str, int] = field(default_factory=dict)
    late: dict[str, list[str]] = field(default_factory=dict)
    code_lines: dict[str, int] = field(default_factory=dict)


def read_facts(sources: Mapping[str, str]) -> Facts:
    """Read each source once, and keep no trees: they have a million objects."""
    facts = Facts()
    for path, text in sources.items():
        # A docstring, a comment and an import are no code.
        code = {number for token in tokenize.generate_tokens(io.StringIO(text).readline)
                if token.type not in NO_CODE
                for number in range(token.start[0], token.end[0] + 1)}
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import | ast.ImportFrom) or (
                    isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
                code -= {*range(node.lineno, (node.end_lineno or 0) + 1)}
            name = f'{path}:{getattr(node, "name", "")}'
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                keep_most(facts.lengths, name, (node.end_lineno or 0) - node.lineno + 1)
                keep_most(facts.parameters, name, count_parameters(node))
                if node.name == '__init__':
                    facts.late.setdefault(path, []).extend(late_attributes(node))
            elif isinstance(node, ast.ClassDef):
                keep_most(facts.methods, name, sum(
                    isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef)
                    for one in ast.iter_child_nodes(node)))
        facts.code_lines[path] = len(code)
    return facts


def keep_most(counts: dict[str, int], name: str, count: int) -> None:
    """Keep the largest count of a name, which several definitions of a file may have."""
    counts[name] = max(count, counts.get(name, 0))


def count_parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Count the parameters of a function without ``self``."""
    names = [one.arg for one in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    return len(names) - (names[:1] in (['self'], ['cls']))


def late_attributes(constructor: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    """Return the attributes that a constructor sets after it gave a callback to an executor."""
    late = []
    is_given = False
    for statement in constructor.body:
        nodes = [*ast.walk(statement)]
        later = [inner for node in nodes if isinstance(node, ast.Lambda)
                 for inner in ast.walk(node)]
        gives = any(
            isinstance(node, ast.Call) and node not in later
            and _GIVES.fullmatch(ast.unparse(node.func).rpartition('.')[2]) for node in nodes
        ) and '_NeverExecuted' not in ast.unparse(statement)
        if is_given and not gives:
            late += [node.attr for node in nodes if isinstance(node, ast.Attribute)
                     and isinstance(node.ctx, ast.Store)]
        is_given |= gives
    return late


@cache
def facts_of_the_package() -> Facts:
    return read_facts(SOURCES)


def test_code_lines_by_room() -> None:
    rooms: Counter[str] = Counter()
    for path, lines in facts_of_the_package().code_lines.items():
        _, *folder, _ = path.split('/')
        rooms[folder[0] if folder else ''] += lines
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


def test_page_of_the_viewer_has_at_most_3400_lines() -> None:
    # Without the heads with the licence and the comments that tsc checks, see test_linters.py.
    # Pages of their own do not count.
    texts = [path.read_text() for path in (ROOT / 'opencv_tools' / 'viewer' / 'page').iterdir()
             if not path.name.startswith(('calibrate', 'token', 'graph'))]
    assert len(texts) > 10
    lines = [_TYPED.sub('', text.rpartition(_LICENCE_END)[2]).count('\n') for text in texts]
    assert sum(lines) <= 3400


def test_documents_import_public_modules_only() -> None:
    public = re.findall(r'automodule:: (\S+)', (ROOT / 'docs' / 'api.rst').read_text())
    assert 5 < len(public) < 16
    pages = [ROOT / 'README.md', *(ROOT / 'docs').glob('*.md'), *(ROOT / 'examples').glob('*.py')]
    imported = {name: path.name for path in pages if path.name != 'demo.py' for name in re.findall(
        r'^(?:from|import) (opencv_tools\S*)', path.read_text(), re.MULTILINE)}
    assert len(imported) > 4
    assert {name: page for name, page in imported.items() if name not in public} == {}


def test_functions_have_at_most_50_lines() -> None:
    lengths = facts_of_the_package().lengths
    assert len(lengths) > 1000
    assert {name: length for name, length in lengths.items() if length > 50} == {}


def test_class_names_occur_once() -> None:
    files: dict[str, list[str]] = {}
    for path, _, name in (full.partition(':') for full in facts_of_the_package().methods):
        if not name.startswith('_'):
            files.setdefault(name, []).append(path)
    assert {name: paths for name, paths in files.items() if len(paths) > 1} == {}


def test_few_signatures_have_more_than_6_parameters() -> None:
    long = {name: count for name, count in facts_of_the_package().parameters.items() if count > 6}
    assert len(long) <= 5, long


def test_few_classes_have_more_than_12_methods() -> None:
    large = {name: count for name, count in facts_of_the_package().methods.items() if count > 12}
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


def test_constructors_give_callbacks_to_an_executor_last() -> None:
    examples = {path.name: path.read_text() for path in (ROOT / 'examples').rglob('*.py')}
    late = {**facts_of_the_package().late, **read_facts(examples).late}
    assert len(late) > 100
    assert {name: names for name, names in late.items() if names} == {}


@pytest.mark.parametrize('statement', [
    'node.create_timer(1, self.f)', 'self.w = node.add_waitable(self)', 'thread.start()',
    'self.s = node.receive_frames("t", self.f) if node else None'])
def test_late_attribute_is_found(statement: str) -> None:
    lines = ['class A:', ' def __init__(self):', '  self.a = 1', f'  {statement}', '  self.b = 2']
    texts = {'late': '\n'.join(lines), 'fine': '\n'.join([*lines[:2], *lines[4:], lines[3]])}
    assert read_facts(texts).late == {'late': ['b'], 'fine': []}


def test_picture_of_a_graph() -> None:
    graph = {'low': frozenset(), 'a': frozenset({'low'}), 'b': frozenset({'low', 'a'}),
             'alone': frozenset()}
    assert WRITE_IMPORTS.picture(graph) == 'b     -> a\n\na     -> low\n\nlow\nalone\n'


def test_threads_and_locks_are_on_the_page() -> None:
    page = (ROOT / 'docs' / 'data_ways.md').read_text()
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
        'the imports in docs/imports.md are not those of the code: run '
        'python3 docs/write_imports.py')
