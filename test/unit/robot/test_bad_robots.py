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

"""Invalid and hostile input: one line, exit status 2, limited time, and no output."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import json
import os
from pathlib import Path
import resource
import signal
import subprocess
import sys

from conftest import PRINT_PEAK_MEMORY
from opencv_tools.robot.cli import robot_compare, robot_frames, sdf_to_urdf, urdf_to_sdf
import pytest
from rows import failures
from waiting import communicate, LONGEST_SECONDS, pause, status_of, wait_until

ROOT = Path(__file__).parents[3]
ROBOTS = Path(__file__).parents[2] / 'data' / 'robots' / 'urdf'
# Processor time in seconds, thirty times the usual, so that a slow machine does not fail.
MAX_SECONDS = 15.0
SECRET = 'not for everyone'
DEEP = 10_000

XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'


def _bomb(document: str) -> str:
    """Return the beginning of a document with entities that expand to a gigabyte."""
    declared = [f'<!ENTITY e{n} "{f"&e{n - 1};" * 10}">' for n in range(1, 10)]
    return '\n'.join([f'<!DOCTYPE {document} [', '<!ENTITY e0 "ha">', *declared, ']>', ''])


def _nested(tag: str) -> str:
    return f'<{tag}>' * DEEP + f'</{tag}>' * DEEP


URDF_BOMB = f'{_bomb("robot")}<robot name="robot"><link name="&e9;"/></robot>'
SDF_BOMB = f'{_bomb("sdf")}<sdf version="1.7"><model name="r"><link name="&e9;"/></model></sdf>'
EXTERNAL = ('<!DOCTYPE robot [<!ENTITY secret SYSTEM "{secret}">]>\n'
            '<robot name="robot" {more}><link name="base"/>&secret;</robot>')
EXTERNAL_DTD = ('<!DOCTYPE robot SYSTEM "{secret}">\n'
                '<robot name="&secret;"><link name="base"/></robot>')
PARAMETER = ('<!DOCTYPE robot [<!ENTITY % secret SYSTEM "{secret}"> %secret;]>\n'
             '<robot name="robot"><link name="base"/></robot>')


@dataclass(frozen=True)
class Bad:
    """
    A file that is refused.

    :param words: parts of the message.
    :param others: names and contents of files in the same folder.
    """

    data: str | bytes
    words: tuple[str, ...]
    name: str = 'robot.urdf'
    others: tuple[tuple[str, str], ...] = ()


# Files that could use up memory or time; they are read in another process.
HOSTILE = {
    'entity bomb in URDF': Bad(URDF_BOMB, ('robot.urdf:2: ', '<!ENTITY>')),
    'entity bomb in UTF-16': Bad(
        '<?xml version="1.0" encoding="UTF-16"?>'.encode('utf-16') + URDF_BOMB.encode('utf-16-le'),
        ('robot.urdf',)),
    'entity bomb in SDF': Bad(SDF_BOMB, ('robot.sdf:2: ', '<!ENTITY>'), 'robot.sdf'),
    'entity bomb in xacro': Bad(URDF_BOMB.replace('<robot name', f'<robot {XACRO} name'),
                                ('robot.urdf:2: ', '<!ENTITY>')),
    'entity bomb in a file that xacro includes': Bad(
        f'<robot name="robot" {XACRO}>\n<xacro:include filename="bomb.xacro"/></robot>',
        ('bomb.xacro:2',), others=(('bomb.xacro', URDF_BOMB),)),
    'entity bomb in an included SDF': Bad(
        '<sdf version="1.8">\n<model name="r">\n<include><uri>bomb.sdf</uri></include></model>'
        '</sdf>', ('bomb.sdf:2',), 'robot.sdf', (('bomb.sdf', SDF_BOMB),)),
    'nested in URDF': Bad(f'<robot name="robot">\n{_nested("link")}</robot>', (
        'robot.urdf:2: ', 'nested')),
    'nested in SDF': Bad(f'<sdf version="1.7">\n{_nested("model")}</sdf>', (
        'robot.sdf:2: ', 'nested'), 'robot.sdf'),
    'nested in xacro': Bad(f'<robot name="robot" {XACRO}>\n{_nested("xacro:if")}</robot>', (
        'robot.urdf:2: ', 'nested')),
    'models in models': Bad(
        '<sdf version="1.8">' + ''.join(f'<model name="m{n}">' for n in range(DEEP))
        + '</model>' * DEEP + '</sdf>', ('nested',), 'robot.sdf'),
    'a macro that calls itself': Bad(
        f'<robot name="robot" {XACRO}>\n<xacro:macro name="again"><xacro:again/></xacro:macro>\n'
        '<xacro:again/></robot>', ('robot.urdf', 'again')),
    'xacro that includes itself by way of another file': Bad(
        f'<robot name="robot" {XACRO}>\n<xacro:include filename="b.xacro"/></robot>',
        ('includes itself',), 'a.xacro',
        (('b.xacro', f'<robot {XACRO}><xacro:include filename="a.xacro"/></robot>'),)),
    'SDF that includes itself by way of another file': Bad(
        '<sdf version="1.8"><model name="a"><include><uri>b.sdf</uri></include></model></sdf>',
        ('include cycle', 'a.sdf -> '), 'a.sdf',
        (('b.sdf', '<sdf version="1.8"><model name="b">\n<include><uri>a.sdf</uri></include>'
                   '</model></sdf>'),)),
    'includes that double with every file': Bad(
        '<sdf version="1.8"><model name="m"><include><uri>0.sdf</uri></include></model></sdf>',
        ('includes',), 'a.sdf', (*((f'{n}.sdf', '<sdf version="1.8"><model name="m">' + ''.join(
            f'<include><uri>{n + 1}.sdf</uri><name>{name}</name></include>' for name in 'ab')
            + '</model></sdf>') for n in range(30)),
            ('30.sdf', '<sdf version="1.8"><model name="m"><link name="a"/></model></sdf>'))),
}

# Files with entities whose content must not be read.
READS_FILES = {
    'external entity': Bad(EXTERNAL, ('entit',)),
    'external entity in xacro': Bad(EXTERNAL.replace('{more}', XACRO), ('entit',)),
    'entity in an attribute in UTF-16': Bad(
        '<!DOCTYPE robot [<!ENTITY name "arm">]><robot name="&name;"><link name="base"/></robot>'
        .encode('utf-16'), ('entity declarations are not supported',)),
    'external entity in UTF-16': Bad(EXTERNAL.encode('utf-16'), ('entit',)),
    'external entity in UTF-16 in xacro': Bad(
        EXTERNAL.replace('{more}', XACRO).encode('utf-16'), ('entit',)),
    'parameter entity': Bad(PARAMETER, ('entit',)),
}

# Files that are only invalid; they are read in this process.
INVALID = {
    'not UTF-8': Bad(b'<robot name="\xff\xfe\xfa">\n<link name="base"/></robot>', (
        'not well-formed XML',)),
    'a picture': Bad(b'\x89PNG\r\n\x1a\n\0\0\0\rIHDR', ('not well-formed XML',)),
    'zeros': Bad(bytes(1000), ('not well-formed XML',)),
    'blanks': Bad(' \n \n', ('not well-formed XML',)),
    'an unknown encoding': Bad('<?xml version="1.0" encoding="klingon"?><robot name="a"/>', (
        'not well-formed XML',)),
    'cut off': Bad((ROBOTS / 'ok_arm.urdf').read_text()[:500], ('not well-formed XML',)),
    'an undeclared prefix and a tag that is not closed': Bad(
        '<robot name="a">\n<link name="b"><x:y/>\n</robot>', (
            'robot.urdf:3: ', 'not well-formed XML', 'link line 2')),
    'too many tags': Bad('<robot name="a"><link name="b"/>' + '<a/>' * 1_000_000 + '</robot>', (
        'robot.urdf: has more than 1000000 tags',)),
    'too many attributes': Bad(
        f'<robot name="a"><link name="b"{" a=" * 1_000_000}/></robot>', (
            'robot.urdf: has more than 1000000 tags',)),
    'an element with many attributes': Bad(
        '<robot name="a"><link name="b" ' + ' '.join(f'x{n}="1"' for n in range(1001))
        + '/></robot>', ('robot.urdf: has an element with more than 1000 attributes',)),
    'two roots': Bad('<robot name="a"><link name="b"/></robot>\n<robot name="c"/>', (
        'robot.urdf:2: ', 'not well-formed XML')),
    'a number of 100,000 digits': Bad(
        f'<robot name="r"><link name="a"><collision><geometry><sphere radius="{"9" * 100_000}"/>'
        '</geometry></collision></link></robot>', ('<sphere>', 'radius')),
    'a number that is too large': Bad(
        '<robot name="r"><link name="a"><collision><geometry><sphere radius="1e999"/>'
        '</geometry></collision></link></robot>', ('<sphere>', "radius='1e999'")),
    'a number of Python': Bad(
        '<robot name="r"><link name="a"><collision>\n<geometry><sphere radius="1_0"/></geometry>'
        '</collision></link></robot>', ('robot.urdf:2: <sphere>: ', "radius='1_0'")),
    'digits of another script': Bad(
        '<robot name="r"><link name="a"><collision>\n<geometry><sphere radius="\u0661"/>'
        '</geometry></collision></link></robot>', ('robot.urdf:2: <sphere>: ', 'radius=')),
}


def _written(bad: Bad, folder: Path) -> Path:
    data = bad.data.encode() if isinstance(bad.data, str) else bad.data
    path = folder / bad.name
    path.write_bytes(data)
    for name, text in bad.others:
        (folder / name).write_text(text)
    return path


def _name(path: Path) -> str:
    return 'sdf_to_urdf' if path.suffix == '.sdf' else 'urdf_to_sdf'


def _process(*arguments: str) -> list[str]:
    return [sys.executable, '-m', 'opencv_tools.robot.cli', *arguments]


def _refused(command: str, path: Path, output: Path) -> str:
    """Run a command that refuses its input, and return its message."""
    before = _children_time()
    done = subprocess.run(_process(command, str(path), '-o', str(output)), cwd=ROOT,
                          capture_output=True, text=True, timeout=LONGEST_SECONDS)
    assert _children_time() - before < MAX_SECONDS
    assert done.returncode == 2, done.stderr
    assert done.stdout == ''
    assert not output.exists()
    return _one_line(done.stderr, command)


def _children_time() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _one_line(message: str, command: str) -> str:
    assert message.startswith(f'{command}: error: ')
    assert message.count('\n') == 1, message
    assert 'Traceback' not in message
    assert len(message) < 2000, f'{len(message)} characters are no line'
    return message


# Runs commands, and writes the exit status and the processor time of each after its messages.
_COMMANDS = """
import json, os, sys
from opencv_tools.robot import cli
for command, path, output in json.loads(sys.argv[1]):
    before = sum(os.times()[:4])
    status = getattr(cli, command)([path, '-o', output])
    sys.stderr.write(f'\\0{status}\\0{sum(os.times()[:4]) - before}\\0')
"""


@pytest.mark.process
def test_hostile_files(tmp_path: Path) -> None:
    runs = []
    for number, bad in enumerate(HOSTILE.values()):
        folder = tmp_path / str(number)
        folder.mkdir()
        path = _written(bad, folder)
        runs.append((_name(path), str(path), str(folder / 'output')))
    done = subprocess.run([sys.executable, '-c', _COMMANDS, json.dumps(runs)], cwd=ROOT,
                          capture_output=True, text=True, timeout=LONGEST_SECONDS)
    told = done.stderr.split('\0')
    assert len(told) == 3 * len(runs) + 1, told[-1]  # a command has ended the process
    assert done.stdout == ''
    assert failures(_check_refusal, zip(
        HOSTILE, runs, told[::3], told[1::3], told[2::3], strict=False)) == []


def _check_refusal(name: str, run: tuple[str, str, str], message: str, status: str,
                   seconds: str) -> None:
    command, _, output = run
    assert status == '2', message
    assert float(seconds) < MAX_SECONDS
    assert not Path(output).exists()
    for words in HOSTILE[name].words:
        assert words in _one_line(message, command)


def _with_secret(bad: Bad, folder: Path) -> Path:
    """Write a file that names another one, whose content is ``SECRET``."""
    secret = folder / 'secret'
    secret.write_text(SECRET)
    in_utf16 = isinstance(bad.data, bytes)
    text = bad.data.decode('utf-16') if isinstance(bad.data, bytes) else bad.data
    text = text.replace('{secret}', secret.as_uri()).replace('{more}', '')
    path = folder / bad.name
    path.write_bytes(text.encode('utf-16' if in_utf16 else 'utf-8'))
    return path


@pytest.mark.parametrize('bad', READS_FILES.values(), ids=READS_FILES.keys())
def test_external_entities_are_not_read(
        bad: Bad, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert urdf_to_sdf([str(_with_secret(bad, tmp_path))]) == 2
    output, message = capfd.readouterr()
    assert SECRET not in message
    assert output == ''
    for words in bad.words:
        assert words in _one_line(message, 'urdf_to_sdf')


def test_external_dtd_is_not_read(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert urdf_to_sdf([str(_with_secret(Bad(EXTERNAL_DTD, ()), tmp_path))]) == 0
    output, message = capfd.readouterr()
    assert SECRET not in output + message
    assert '<model name="robot">' in output


@pytest.mark.parametrize('bad', INVALID.values(), ids=INVALID.keys())
def test_invalid_files(bad: Bad, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path, output = _written(bad, tmp_path), tmp_path / 'output'
    output.write_text('from before')
    command = {'sdf_to_urdf': sdf_to_urdf, 'urdf_to_sdf': urdf_to_sdf}[_name(path)]
    assert command([str(path), '-o', str(output)]) == 2
    printed, message = capfd.readouterr()
    assert printed == ''
    message = _one_line(message, _name(path))
    assert str(path) in message
    for words in bad.words:
        assert words in message
    assert output.read_text() == 'from before'
    assert sorted(tmp_path.iterdir()) == sorted([path, output])


def test_file_names_in_messages(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'a b%20ü.urdf'
    path.write_text('<robot name="r"><link/></robot>')
    assert urdf_to_sdf([str(path)]) == 2
    assert f'{path}:1: <link>' in capfd.readouterr().err


@pytest.mark.parametrize('command', [urdf_to_sdf, sdf_to_urdf, robot_frames])
def test_unreadable_paths(
        command: Callable[[list[str]], int], tmp_path: Path,
        capfd: pytest.CaptureFixture[str]) -> None:
    pipe, text = tmp_path / 'pipe', tmp_path / 'text'
    os.mkfifo(pipe)
    text.touch()
    for path, words in [(tmp_path, 'is a folder without model.config and model.sdf; name a file'),
                        (tmp_path / 'none', 'No such file'),
                        (tmp_path / 'none' / 'none.urdf', 'No such file'),
                        (text / 'none.urdf', 'Not a directory'),
                        (tmp_path / ('a' * 300), 'File name too long'),
                        (pipe, 'pipe is a named pipe, not a regular file'),
                        (Path('/dev/null'), 'a device, not a regular file')]:
        assert command([str(path)]) == 2
        message = _one_line(capfd.readouterr().err, command.__name__)
        assert str(path) in message
        assert words in message


@pytest.mark.parametrize(('uri', 'instead'), [
    ('https://example.com/a.urdf', 'download the file and give its path'),
    ('package://arm/urdf/a.urdf', 'give the path $(ros2 pkg prefix --share arm)/urdf/a.urdf'),
    ('model://arm', 'give the path of the file or of the model folder'),
    ('file:///home/a.urdf', 'give the path /home/a.urdf')])
def test_uris_are_not_read(uri: str, instead: str, capfd: pytest.CaptureFixture[str]) -> None:
    for command in (urdf_to_sdf, sdf_to_urdf, robot_frames):
        assert command([uri]) == 2
        scheme = uri.partition(':')[0]
        assert _one_line(capfd.readouterr().err, command.__name__) == (
            f'{command.__name__}: error: {uri}: cannot be read: URIs of {scheme}: '
            f'are not supported; {instead}\n')


@pytest.mark.parametrize('folder', ['/dev/fd', '/proc/self/fd'])
def test_files_that_the_shell_opened(folder: str, capfd: pytest.CaptureFixture[str]) -> None:
    reading, writing = os.pipe()
    os.write(writing, b'<robot name="a"><link name="b"/></robot>')
    os.close(writing)
    try:
        assert urdf_to_sdf([f'{folder}/{reading}', '--inertial', 'zero']) == 0
    finally:
        os.close(reading)
    assert '<link name="b">' in capfd.readouterr().out


def test_comparison_with_an_unreadable_file(
        tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    fine, none = str(ROBOTS / 'ok_arm.urdf'), str(tmp_path / 'none.urdf')
    for arguments in ([fine, none], [none, fine]):
        assert robot_compare(arguments) == 2
        assert none in _one_line(capfd.readouterr().err, 'robot_compare')


@pytest.mark.process
def test_endless_device() -> None:
    message = _refused('urdf_to_sdf', Path('/dev/zero'), Path('/nowhere/output'))
    assert '/dev/zero' in message


@pytest.mark.thorough
@pytest.mark.process
def test_memory_for_many_dashes_in_comments(tmp_path: Path) -> None:
    path = tmp_path / 'robot.sdf'
    with path.open('wb') as file:
        file.write(b'<sdf version="1.6">\n')
        for _ in range(8):
            file.write(b'<!-- ' + b'-- ' * 2_500_000 + b'-->\n')
        file.write(b'<model name="m"><link name="a"/></model></sdf>')
    script = ('import sys\n'
              'from opencv_tools.robot.cli import sdf_to_urdf\n'
              'status = sdf_to_urdf([sys.argv[1], "--inertial", "zero", "-o", sys.argv[2]])\n'
              f'{PRINT_PEAK_MEMORY}\n'
              'sys.exit(status)')
    output = tmp_path / 'output'
    finished = subprocess.run(
        [sys.executable, '-c', script, str(path), str(output)], capture_output=True, text=True,
        cwd=ROOT, timeout=LONGEST_SECONDS, check=True)
    assert int(finished.stdout) < 1_000_000  # KB; 4,500,000 with an object for every dash
    assert '<link name="a">' in output.read_text()


@pytest.mark.parametrize('output', ['none/output.sdf', 'file/output.sdf', '.'])
def test_unwritable_output(output: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / 'file').touch()
    target = tmp_path / output
    assert urdf_to_sdf([str(ROBOTS / 'ok_arm.urdf'), '-o', str(target)]) == 2
    printed, message = capfd.readouterr()
    assert printed == ''
    assert str(target) in _one_line(message, 'urdf_to_sdf')
    assert 'cannot be written' in message
    assert list(tmp_path.iterdir()) == [tmp_path / 'file']


# An unbuffered write can be partial. A buffered write that fails is repeated at exit.
BUFFERS = pytest.mark.parametrize('unbuffered', ['', '1'], ids=['buffered', 'unbuffered'])


@pytest.mark.process
@BUFFERS
def test_full_disk(unbuffered: str) -> None:
    with Path('/dev/full').open('wb') as full:
        done = subprocess.run(_process('urdf_to_sdf', str(ROBOTS / 'ok_arm.urdf')), cwd=ROOT,
                              stdout=full, stderr=subprocess.PIPE, text=True,
                              timeout=LONGEST_SECONDS,
                              env={**os.environ, 'PYTHONUNBUFFERED': unbuffered})
    assert done.returncode == 2, done.stderr
    assert 'No space left' in _one_line(done.stderr, 'urdf_to_sdf')


@pytest.mark.quick_cases(1)
@pytest.mark.process
@BUFFERS
def test_closed_pipe(unbuffered: str, tmp_path: Path) -> None:
    # The output is larger than a pipe, so the command still writes when the pipe is closed.
    links = ''.join(f'<link name="{"a" * 100}{n}"/>' for n in range(2000))
    joints = ''.join(
        f'<joint name="{n}" type="fixed"><parent link="{"a" * 100}0"/>'
        f'<child link="{"a" * 100}{n}"/></joint>' for n in range(1, 2000))
    path = tmp_path / 'robot.urdf'
    path.write_text(f'<robot name="robot">{links}{joints}</robot>')
    with subprocess.Popen(_process('urdf_to_sdf', str(path), '--inertial', 'zero'), cwd=ROOT,
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                          env={**os.environ, 'PYTHONUNBUFFERED': unbuffered}) as process:
        assert process.stdout and process.stderr
        assert process.stdout.readline().startswith(b'<?xml')
        process.stdout.close()
        assert process.stderr.read() == b''
    assert process.returncode == 128 + signal.SIGPIPE


@pytest.mark.process
def test_ctrl_c_during_the_expansion_of_xacro(tmp_path: Path) -> None:
    path = tmp_path / 'robot.urdf.xacro'
    path.write_text(f'<robot name="a" {XACRO}><link name="${{9**9**9}}"/></robot>')
    command = ['env', '--default-signal=INT', *_process('urdf_to_sdf', str(path))]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE) as process:
        child = _child_of(process.pid)
        process.send_signal(signal.SIGINT)
        assert communicate(process) == (b'', b'')
    assert process.returncode == 128 + signal.SIGINT
    # The limit of 20 s of processor time must not be what ends it.
    while (used := _used(child)) is not None:
        assert used < 10
        pause(0.01)


def _used(pid: str) -> float | None:
    """Return the processor time of a process in seconds, or None if it has ended."""
    fields = _stat(pid)
    if fields[0] in 'ZX':
        return None
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def _stat(pid: str) -> list[str]:
    """Return the fields of /proc/pid/stat from the state on; the state is Z after the end."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    except (FileNotFoundError, ProcessLookupError):
        return ['Z']


def _child_of(pid: int) -> str:
    """Return the child of a process, when it has started and the process sleeps."""
    children = wait_until(lambda: [path.name for path in Path('/proc').glob('[0-9]*')
                                   if _stat(path.name)[1:2] == [f'{pid}']], 'the child')
    _wait_until_asleep(pid)
    return children[0]


@pytest.mark.process
def test_ctrl_c() -> None:
    # Background processes of a shell ignore SIGINT, and so do their children.
    command = ['env', '--default-signal=INT', *_process('urdf_to_sdf', '-')]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE) as process:
        assert process.stdin
        # More data than a pipe holds is only written after the process reads.
        process.stdin.write(bytes(1_000_000))
        process.stdin.flush()
        # Python handles a signal that arrives just before a wait only after the wait.
        _wait_until_asleep(process.pid)
        process.send_signal(signal.SIGINT)
        assert status_of(process) == 128 + signal.SIGINT
        assert process.stdout and process.stderr
        assert (process.stdout.read(), process.stderr.read()) == (b'', b'')


def _wait_until_asleep(pid: int) -> None:
    """Wait until a process sleeps, for example while it waits for input."""
    wait_until(lambda: _stat(f'{pid}')[0] == 'S', 'its sleep')


def test_poses_too_far_away(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    far = '<origin xyz="1.7e308 0 0"/>'
    urdf = tmp_path / 'far.urdf'
    urdf.write_text('<robot name="r"><link name="a"/><link name="b"/><link name="c"/>' + ''.join(
        f'<joint name="{parent}{child}" type="fixed"><parent link="{parent}"/>'
        f'<child link="{child}"/>{far}</joint>' for parent, child in ('ab', 'bc')) + '</robot>')
    sdf = tmp_path / 'far.sdf'
    sdf.write_text('<sdf version="1.9"><model name="m"><link name="a">'
                   '<pose>-1.7e308 0 0 0 0 0</pose></link><link name="b">'
                   '<pose>1.7e308 0 0 0 0 0</pose></link><joint name="j" type="fixed">'
                   '<parent>a</parent><child>b</child></joint></model></sdf>')
    for command, arguments in ((urdf_to_sdf, [urdf]), (sdf_to_urdf, [sdf]),
                               (robot_frames, [urdf]), (robot_compare, [urdf, urdf])):
        assert command(list(map(str, arguments))) == 2
        told = capsys.readouterr().err.splitlines()
        assert 'not finite' in told[-1] or 'too far away' in told[-1], told
