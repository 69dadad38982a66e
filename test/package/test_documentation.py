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
README.md and the pages of docs: their blocks run, their commands and links name what exists.

A mark on the line before a block says how it is run::

    <!-- test: until TEXT -->       Ctrl-C follows TEXT in the output
    <!-- test: needs camera -->     only the names in its commands are checked
    <!-- test: needs ros -->        the same
    <!-- test: needs root -->       it runs in a namespace that protects the machine
    <!-- test: not run: REASON -->  only the names in its commands are checked

``;`` separates several marks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import importlib.util
import json
import os
from pathlib import Path
import re
import shutil
import sys

from documentation import (
    Block, PAGES, read_anchors, read_blocks, read_links, read_spans, ROOT, RUN, SHOWN)
from documentation_runs import copy_project, matches, run
from documented_commands import check_command, check_span, commands
import pytest

TEXTS = (*PAGES, Path('CONTRIBUTING.md'), Path('SECURITY.md'))
BLOCKS = [block for page in PAGES for block in read_blocks(page)]
HAS_LAUNCH = importlib.util.find_spec('launch_ros') is not None

# Runs the blocks of a page, so that a traceback names the line of the page.
DRIVER = """
import json, sys
namespace = {'__name__': '__main__'}
for page, line, code in json.loads(sys.argv[1]):
    exec(compile('\\n' * line + code, page, 'exec'), namespace)
"""


def _runs(block: Block) -> bool:
    """Return whether a block runs on this machine."""
    return block.is_run and (HAS_LAUNCH or 'ros2 launch' not in block.code)


def _scripts(language: str) -> list[object]:
    """Return the blocks of a language that run here."""
    return [pytest.param(block, id=block.name)
            for block in BLOCKS if block.language == language and _runs(block)]


def _programs() -> Iterator[object]:
    """Yield the blocks of Python that run together: those of a page that end by themselves."""
    for page in PAGES:
        blocks = [block for block in BLOCKS
                  if block.page == page and block.language == 'python' and _runs(block)]
        whole = [block for block in blocks if not block.until]
        for number, block in enumerate(blocks):
            if block.until:
                before = [other for other in blocks[:number] if not other.until]
                yield pytest.param([*before, block], id=block.name)
        if whole:
            yield pytest.param(whole, id=whole[0].name)


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Return the root of a copy of the project."""
    return copy_project(tmp_path)


def check_output(block: Block, status: int, output: str) -> None:
    """Check that a block ended as it should."""
    assert status == 0, f'{block.name} ended with {status}:\n{output}'
    assert 'Traceback' not in output, f'{block.name}:\n{output}'


@pytest.mark.process
@pytest.mark.parametrize('block', _scripts('bash'))
def test_bash_block(block: Block, project: Path, start: Callable[..., object],
                    request: pytest.FixtureRequest) -> None:
    prefix: tuple[str, ...] = ()
    if 'needs root' in block.marks:
        prefix = protected(block, project, request.getfixturevalue('mount_namespace'))
    if block.until and 'img_subscriber' in block.code and 'img_publisher' not in block.code:
        start('img_publisher', source='pattern')
    script = project.parent / 'script'
    script.write_text(block.code)
    status, output = run((*prefix, 'bash', '-e', '-o', 'pipefail', str(script)), project,
                         block.until)
    check_output(block, status, output)
    for file, value in settings(block, project).items():
        assert file.read_text().strip() == value


def settings(block: Block, project: Path) -> dict[Path, str]:
    """Return the kernel's settings that a block changes: stand-ins of their files, and values."""
    found = re.findall(r'sysctl -w ([\w.]+)=(\S+)', block.code)
    return {project.parent / name: value for name, value in found}


def protected(block: Block, project: Path, namespace: tuple[str, ...]) -> tuple[str, ...]:
    """Return what to run a block within, so that it does not change settings of this machine."""
    if shutil.which('sysctl') is None:
        pytest.skip('sysctl is not on this machine; sudo apt install procps')
    mounts = []
    for file in settings(block, project):
        file.touch()
        mounts.append(f'mount --bind {file} /proc/sys/{file.name.replace(".", "/")} && ')
    assert mounts, f'{block.name}: only sysctl -w NAME=VALUE is known of what needs root'
    return (*namespace, 'bash', '-c', f'{"".join(mounts)}exec "$@"', 'bash')


@pytest.mark.process
@pytest.mark.parametrize('block', _scripts('console'))
def test_console_block(block: Block, project: Path) -> None:
    expected: list[tuple[str, str]] = []
    for line in block.code.replace('\\\n', ' ').splitlines():
        if line.startswith('$ '):
            expected.append((line[2:], ''))
        else:
            assert expected, f'{block.name}: the first line is no command'
            expected[-1] = (expected[-1][0], f'{expected[-1][1]}{line}\n')
    end = '=== end of the command ==='
    script = project.parent / 'script'
    script.write_text(''.join(f'{command}\necho "{end}"\n' for command, _ in expected))
    status, output = run(('bash', '-e', '-o', 'pipefail', str(script)), project, block.until)
    check_output(block, status, output)
    printed = output.split(f'{end}\n')
    for (command, lines), actual in zip(expected, printed):
        assert matches(lines, actual), f'{block.name}: {command} prints\n{actual}\nnot\n{lines}'


@pytest.mark.process
@pytest.mark.parametrize('blocks', [*_programs()])
def test_python_blocks(blocks: list[Block], project: Path) -> None:
    code = json.dumps([(str(block.page), block.line, block.code) for block in blocks])
    status, output = run((sys.executable, '-c', DRIVER, code), project, blocks[-1].until)
    check_output(blocks[-1], status, output)
    comments = [comment for block in blocks
                for comment in re.findall(r'^ *print\(.*\)  # (.*)$', block.code, re.MULTILINE)]
    if comments:
        assert matches('\n'.join(comments), output), f'{blocks[0].name} prints\n{output}'


@pytest.mark.parametrize('block', [pytest.param(block, id=block.name) for block in BLOCKS])
def test_block_form(block: Block) -> None:
    assert block.language in (*RUN, *SHOWN), f'{block.name}: write it as one of {RUN}'
    assert block.marks_are_known(), f'{block.name}: unknown mark in {block.marks}'
    assert block.language in RUN or not block.marks, f'{block.name}: a mark without a run'
    if block.language == '':
        assert not block.code.startswith('$ '), f'{block.name}: write it as console'
    if block.language in ('bash', 'console'):
        for line in commands(block):
            check_command(line)
    elif block.language == 'python':
        compile(block.code, block.name, 'exec')


@pytest.mark.parametrize('page', [pytest.param(page, id=str(page)) for page in TEXTS])
def test_links(page: Path) -> None:
    assert [link for link in read_links(page) if not leads_somewhere(page, link)] == []


def leads_somewhere(page: Path, link: str) -> bool:
    """Return whether a link of a page has a target: a URL, or a file and a heading in it."""
    if re.match(r'\w+:', link):
        return True
    file, _, anchor = link.partition('#')
    target = Path(os.path.normpath(page.parent / file)) if file else page
    return (ROOT / target).exists() and (not anchor or anchor in read_anchors(target))


@pytest.mark.parametrize('page', [pytest.param(page, id=str(page)) for page in TEXTS])
def test_names_in_text(page: Path) -> None:
    for span in read_spans(page):
        check_span(span)


def test_pages_are_in_the_contents() -> None:
    contents = next(block for block in BLOCKS if block.language == '{toctree}')
    named = re.findall(r'^[a-z]\w*$', contents.code, re.MULTILINE)
    pages = {path.stem for folder in ('*.md', '*.rst') for path in (ROOT / 'docs').glob(folder)}
    assert sorted(named) == sorted(pages - {'index'})


def test_parameter_page_is_up_to_date() -> None:
    spec = importlib.util.spec_from_file_location(
        'write_parameters', ROOT / 'docs' / 'write_parameters.py')
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.PAGE.read_text() == module.parameters_page(), (
        'docs/parameters.md is not that of the tables: run python3 docs/write_parameters.py')
