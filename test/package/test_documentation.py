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
README.md and the pages of docs: their programs run, their commands and links name what exists.

``make test-docs`` types their commands. A mark on the line before a block says how it is run::

    <!-- test: until TEXT -->       Ctrl-C follows TEXT in the output
    <!-- test: file NAME -->        a reader writes the block to this file
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
import subprocess
import sys

from conftest import executable
from documentation import (
    Block, matches, NOTHING_SEEN, PAGES, read_anchors, read_blocks, read_links, read_spans, ROOT,
    RUN, SHOWN)
from documentation_runs import copy_project, run
from documented_commands import check_command, check_span, PARAMETERS
from opencv_tools.image.encodings import ENCODINGS
from opencv_tools.nodes.parameters import describe_parameters
from opencv_tools.transport.shared_frames.memory import MAX_DEPTH
from opencv_tools.transport.shared_frames.reader import MAX_VIEWS
from opencv_tools.viewer.inspect.looks import MAX_LOOKS
from opencv_tools.viewer.overlays.boxes import MAX_BOXES, MAX_DETECTIONS
from opencv_tools.viewer.recording.page_recorder import MAX_RECORDED
import pytest
from rows import failures
from waiting import LONGEST_SECONDS

TEXTS = (*PAGES, *map(Path, ('CONTRIBUTING.md', 'RELEASING.md', 'SECURITY.md')))
BLOCKS = [block for page in PAGES for block in read_blocks(page)]

# Python's words if Ctrl-C comes while rclpy destroys a Future; docs/troubleshooting.md has them.
IN_DESTRUCTOR_OF_RCLPY = re.compile(
    r'^Exception ignored in: <function Future\.__del__ at 0x\w+>\n'
    r'Traceback \(most recent call last\):\n'
    r'  File ".*/rclpy/task\.py", .*\n(?: +.*\n)*\n*KeyboardInterrupt: *\n', re.MULTILINE)

# Runs the blocks of a page, so that a traceback names the line of the page.
DRIVER = """
import json, sys

namespace = {'__name__': '__main__'}
for page, line, code in json.loads(sys.argv[1]):
    exec(compile('\\n' * line + code, page, 'exec'), namespace)
"""


def _programs() -> Iterator[object]:
    """Yield the blocks of Python that run together: those of a page that end by themselves."""
    for page in PAGES:
        blocks = [block for block in BLOCKS
                  if block.page == page and block.language == 'python'
                  and block.is_run and not block.file]
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
    if 'rclpy.spin(' in block.code:
        output = IN_DESTRUCTOR_OF_RCLPY.sub('', output)
    assert 'Traceback' not in output, f'{block.name}:\n{output}'


@pytest.mark.process
@pytest.mark.parametrize('block', [
    pytest.param(block, id=block.name) for block in BLOCKS if 'needs root' in block.marks])
def test_block_that_needs_root(
        block: Block, project: Path, mount_namespace: tuple[str, ...]) -> None:
    script = project.parent / 'script'
    script.write_text(block.code)
    status, output = run((*protected(block, project, mount_namespace), 'bash', '-e', str(script)),
                         project)
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


@pytest.mark.thorough
@pytest.mark.process
@pytest.mark.parametrize('blocks', [*_programs()])
def test_python_blocks(blocks: list[Block], project: Path) -> None:
    code = json.dumps([(str(block.page), block.line, block.code) for block in blocks])
    status, output = run((sys.executable, '-c', DRIVER, code), project, blocks[-1].until)
    check_output(blocks[-1], status, output)
    comments = [comment for block in blocks if not blocks[-1].until
                for comment in re.findall(r'^ *print\(.*\)  # (.*)$', block.code, re.MULTILINE)]
    if comments:
        assert matches('\n'.join(comments), output), f'{blocks[0].name} prints\n{output}'


@pytest.mark.process
@pytest.mark.parametrize('block', [
    pytest.param(block, id=block.name) for block in BLOCKS if block.code.startswith('[Unit]')])
def test_systemd_unit(block: Block, tmp_path: Path) -> None:
    if shutil.which('systemd-analyze') is None:
        pytest.skip('systemd-analyze is not on this machine; sudo apt install systemd')
    unit = tmp_path / 'camera.service'
    program = re.search(r'^ExecStart=\S*/(\S+)(.*)$', block.code, re.MULTILINE)
    assert program and f'{program[1]}{program[2]}'.startswith('img_publisher --ros-args ')
    check_command(f'{program[1]}{program[2]}')
    unit.write_text(block.code.replace(
        program[0], f'ExecStart={executable(program[1])}{program[2]}'))
    finished = subprocess.run(
        ['systemd-analyze', 'verify', '--man=no', unit], capture_output=True, text=True,
        timeout=LONGEST_SECONDS, check=False)
    assert (finished.returncode, finished.stderr) == (0, '')


def wrong_blocks(check: Callable[[Block], None], *languages: str) -> list[str]:
    """Return the blocks in these languages of which a check fails, and the reasons."""
    return failures(check, ((block,) for block in BLOCKS if block.language in languages))


def test_background_processes_end() -> None:
    def check(block: Block) -> None:
        last = [*block.commands()][-1][0]
        assert ' &\n' not in block.code or last.startswith(('kill ', 'wait')), block.name

    assert wrong_blocks(check, 'bash') == []


def test_language_and_marks_of_a_block() -> None:
    def check(block: Block) -> None:
        assert block.language in (*RUN, *SHOWN), f'{block.name}: write it as one of {RUN}'
        assert block.marks_are_known(), f'{block.name}: unknown mark in {block.marks}'
        assert block.language in RUN or not block.marks, f'{block.name}: a mark without a run'

    assert wrong_blocks(check, *(block.language for block in BLOCKS)) == []


def test_no_block_waits_for_a_warning() -> None:
    def check(block: Block) -> None:
        assert NOTHING_SEEN.match(block.until) is None, f'{block.name}: a reader sees nothing'

    assert wrong_blocks(check, *RUN) == []


def test_counted_recordings_end() -> None:
    def check(block: Block) -> None:
        for command, _ in block.commands():
            assert not ('img_subscriber' in command and 'max_frames:=' in command) or re.search(
                'on_overflow:=block|timeout:=', command), f'{block.name}: lost frames do not count'
            assert not (command.startswith('kill') and '.mp4' in block.code), (
                f'{block.name}: the clip may have ended before')

    assert wrong_blocks(check, 'bash', 'console') == []


def test_blocks_with_ros_say_so() -> None:
    def check(block: Block) -> None:
        lines = (ROOT / block.page).read_text().splitlines()[:block.line - 1]
        section = re.split(r'^#+ ', '\n'.join(lines), flags=re.MULTILINE)[-1]
        assert not re.search(r'^ros2 ', block.code, re.MULTILINE) or re.search(
            r'(with|(needs?|have) an installed) ROS\b', ' '.join(section.split()),
            re.IGNORECASE), f'{block.name}: the text does not say that it needs ROS'

    assert wrong_blocks(check, 'bash', 'console') == []


def test_prompt_of_a_block() -> None:
    def check(block: Block) -> None:
        assert block.code.startswith('$ ') == (block.language == 'console'), (
            f'{block.name}: a console, and nothing else, begins with a command after "$ "')

    assert wrong_blocks(check, *RUN, *SHOWN) == []


def test_commands_of_a_block() -> None:
    def check(block: Block) -> None:
        for line, _ in block.commands():
            check_command(line)

    assert wrong_blocks(check, 'bash', 'console') == []


def test_syntax_of_python() -> None:
    def check(block: Block) -> None:
        compile(block.code, block.name, 'exec')

    assert wrong_blocks(check, 'python') == []


def test_links() -> None:
    assert [f'{page}: {link}' for page in TEXTS for link in read_links(page)
            if not leads_somewhere(page, link)] == []


def test_pictures_of_the_viewer_have_a_script() -> None:
    files = {path.name for path in (ROOT / 'docs' / 'images').iterdir()}
    named = {Path(link).name for page in PAGES for link in read_links(page) if 'images/' in link}
    assert named == files
    pictures, sheets = ((ROOT / 'docs' / f'take_{name}.py').read_text()
                        for name in ('pictures', 'sheets'))
    taken = {*re.findall(r"'(\w+)\.jpg'", pictures),
             *(f'pages_{name}' for name in re.findall(r"(?:name=|write_sheet\()'(\w+)'", sheets))}
    assert len(taken) > 15
    assert taken == {Path(name).stem for name in files
                     if name.startswith(('calibrate', 'pages_', 'viewer'))}


def leads_somewhere(page: Path, link: str) -> bool:
    """Return whether a link of a page has a target: a URL, or a file and a heading in it."""
    if re.match(r'\w+:', link):
        return True
    file, _, anchor = link.partition('#')
    target = Path(os.path.normpath(page.parent / file)) if file else page
    return (ROOT / target).exists() and (not anchor or anchor in read_anchors(target))


def test_names_in_text() -> None:
    def check(page: Path) -> None:
        for span in read_spans(page):
            check_span(span)

    assert failures(check, ((page,) for page in TEXTS)) == []


def test_readme_is_a_front_door() -> None:
    text = (ROOT / 'README.md').read_text()
    assert text.count('\n') <= 150
    first_screen = ' '.join(text.splitlines()[:25])
    assert '`img_subscriber` opens no window' in first_screen
    assert '`img_viewer` shows pictures' in first_screen
    order = ('viewer.jpg', '$ make demo', 'img_viewer\n', 'img_subscriber --ros-args',
             'ros2 run opencv_tools img_publisher', 'ros2 run opencv_tools img_subscriber',
             '`make test`', '0.22 ms')
    places = [text.index(part) for part in order]
    assert places == sorted(places)
    numbers = re.findall(r'\[(\d+)\]\((.*?)\)', text)
    assert len(numbers) > 10
    assert [link for number, link in numbers if not re.fullmatch(
        rf'https://github\.com/[\w.-]+/[\w.-]+/(issues|pull)/{number}', link)] == []


def test_pages_are_in_the_contents() -> None:
    named = {str(block.page.parent / name) for block in BLOCKS if block.language == '{toctree}'
             for name in re.findall(r'^[a-z][\w/]*$', block.code, re.MULTILINE)}
    pages = {str(path.relative_to(ROOT).with_suffix('')) for kind in ('*.md', '*.rst')
             for path in (ROOT / 'docs').rglob(kind)}
    assert named == pages - {'docs/index'}


def test_first_line_says_for_whom() -> None:
    texts = {path.name: re.sub(r'<!--.*?-->', '', (ROOT / path).read_text(), flags=re.DOTALL)
             for path in PAGES if path.parts[0] == 'docs' and path.name != 'install.md'
             and path.parts[1:-1] != ('decisions',)}
    assert [name for name, text in texts.items() if not re.match(
        r'# .*\s+(This page is|These pages are) for ', text)] == []


def test_words_of_the_code_are_explained() -> None:
    users = [path for path in PAGES if path.name not in (
        'architecture.md', 'data_ways.md', 'imports.md', 'parameters.md')]
    texts = {str(path): (ROOT / path).read_text() for path in users}
    assert [name for name, text in texts.items()
            if re.search('parameter sets?|level 6', text, re.IGNORECASE)] == []
    assert [name for name, text in texts.items() if name != 'README.md' and re.search(
        r'\bexecutor\b', re.sub('`+.*?`+', '', text, flags=re.DOTALL))
        and '*executor*' not in text] == []


def test_limits_are_those_of_the_code() -> None:
    page = (ROOT / 'docs' / 'limits.md').read_text()
    for row in (f'without a copy | {MAX_VIEWS} |', f'stands still | {MAX_DEPTH} |',
                f'at once | 1, of {MAX_RECORDED} topics |', f'can be asked | {MAX_LOOKS} topics |',
                f'the {MAX_BOXES} boxes with', f'{MAX_DETECTIONS:,} boxes, 8 MB'):
        assert row in page


def test_parameter_page_and_help_are_up_to_date() -> None:
    spec = importlib.util.spec_from_file_location(
        'write_parameters', ROOT / 'docs' / 'write_parameters.py')
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.PAGE.read_text() == module.parameters_page(), (
        'docs/parameters.md is not that of the tables: run python3 docs/write_parameters.py')
    assert {path: path.read_text() for path in module.FOLDER.iterdir()} == module.help_texts()


@pytest.mark.parametrize('name', PARAMETERS)
def test_parameter_page_is_in_the_help(name: str) -> None:
    page = (ROOT / 'docs' / 'parameters.md').read_text()
    section = page.partition(f'\n## {name}\n')[2].partition('\n## ')[0]
    rows = re.findall(r'^\| `(.*)` \| (.*) \| (.*) \| (.*) \| (yes|no) \| (.*) \|$', section,
                      re.MULTILINE)
    assert [row[0] for row in rows] == [parameter.name for parameter in PARAMETERS[name]]
    lines = describe_parameters(PARAMETERS[name]).splitlines()
    assert max(map(len, lines)) < 100
    words = ' '.join(' '.join(lines[1:]).split())
    for title, kind, default, values, changes, description in rows:
        if values.startswith('[encodings]'):
            values = ', '.join((*ENCODINGS, '16UC1', "''"))
        facts = f'{kind}: {values}' if values else kind
        at_run_time = '; at run time' if changes == 'yes' else ''
        start = f'{title} {description} {facts} [{default}]{at_run_time}'.replace('`', '')
        assert words.startswith(start)
        words = words.removeprefix(start).lstrip()
    assert not words
