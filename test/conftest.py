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

"""Shared fixtures: ROS domains, processes that always end, and a plain node."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
import faulthandler
import fcntl
from functools import partial
import hashlib
import itertools
import json
import math
import os
from pathlib import Path
import re
import resource
import shlex
import shutil
import signal
import subprocess
import sys
from threading import Thread
import time
from typing import Any

from ament_index_python.packages import get_package_prefix, PackageNotFoundError
import clean_environment  # noqa: F401 (it changes the environment)
import cv2
import hypothesis
import numpy as np
from opencv_tools.base.signals import END_SIGNALS
import own_namespaces
from prepared import programs
import pytest
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future
from rclpy.timer import Timer
from waiting import LONGEST_SECONDS, pause, status_of, wait_until, work_of

#: Python that prints the peak memory of its process in KB. ru_maxrss begins with the parent's.
PRINT_PEAK_MEMORY = ('import pathlib; print(pathlib.Path("/proc/self/status").read_text()'
                     '.partition("VmHWM:")[2].split()[0])')
CLIP = Path(__file__).parent / 'data' / 'big_buck_bunny_720p.mp4'
CLIP_FRAMES = 90
EXAMPLES = Path(__file__).parent.parent / 'examples'

#: Folders of tests that run only within a command of their own, and the variable that it sets.
OWN_COMMAND = {'browser': 'OPENCV_TOOLS_BROWSER', 'camera': 'OPENCV_TOOLS_CAMERA_MACHINE',
               'network': 'OPENCV_TOOLS_NETWORK', 'interop': 'OPENCV_TOOLS_INTEROP',
               'on_ray': 'OPENCV_TOOLS_RAY', 'in_lerobot': 'OPENCV_TOOLS_LEROBOT',
               'wheel': 'OPENCV_TOOLS_WHEEL'}
collect_ignore = [folder for folder, variable in OWN_COMMAND.items() if variable not in os.environ]

# Modules with fixtures. Tests import them before they name them in pytest_plugins.
pytest.register_assert_rewrite('child_processes', 'pages', 'pair_processes', 'sharing')

# Processes inherit that a signal is ignored, as in the background of a script. Tests send them.
for _number in END_SIGNALS:
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler if _number == signal.SIGINT
                      else signal.SIG_DFL)

# A test never measures the machine.
hypothesis.settings.register_profile('any machine', deadline=None)
hypothesis.settings.load_profile('any machine')

# The processes of the tests multiply no large matrices; their starts take a quarter less time.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

# colcon forbids bytecode. Without it, each worker compiles and rewrites every test in each run.
sys.dont_write_bytecode = False

# `make` sets the prefix of ROS. An activated virtual environment is such a prefix, too.
if not os.environ.get('AMENT_PREFIX_PATH') and Path(sys.prefix, 'share', 'ament_index').is_dir():
    os.environ['AMENT_PREFIX_PATH'] = sys.prefix

#: Seconds after which a test that hangs in a library, which no exception reaches, ends its worker.
HANG_SECONDS = 900.0
_ARM_SECONDS = 60.0  # between new starts of the watch, each of which starts a thread
_armed_at = -math.inf
_stderr = -1  # before pytest captures it
_may_start_processes = True  # the test that runs

# Domains 1 to 100 are safe on Linux. Each worker starts at another domain and locks it. The locks
# are in /dev/shm, because Fast DDS meets other processes there, also those of containers.
_LOCKS = Path('/dev/shm')
_domains = itertools.count(os.getpid() * 7)


def _inherited() -> list[object]:
    """Return what processes inherit from this one, apart from its environment."""
    return [os.sched_getscheduler(0), *map(signal.getsignal, END_SIGNALS)]


_inherited_before = _inherited()


def peak_memory(script: str, *arguments: object) -> int:
    """Return the peak memory in KB of a process that runs Python code to its end."""
    finished = subprocess.run(
        [sys.executable, '-c', f'{script}\n{PRINT_PEAK_MEMORY}', *map(str, arguments)],
        capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr
    return int(finished.stdout)


class NodeProcess:
    """An executable of the package in its own process."""

    def __init__(self, command: list[str], log: Path, environment: dict[str, str],
                 is_prepared: bool = False) -> None:
        self._log = log
        self.left_behind: set[Path] = set()
        with log.open('w') as console, Path(os.devnull).open() as nothing:
            prepared = programs().start(
                command, log.parent, stdin=nothing.fileno(), output=console.fileno(),
                environment=environment) if is_prepared else None
            self._process = prepared or subprocess.Popen(
                command, env=environment, stdin=nothing, stdout=console,
                stderr=subprocess.STDOUT, cwd=log.parent)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def output(self) -> str:
        return self._log.read_text()

    def wait_for(self, text: str) -> None:
        """Wait for a text on the console."""
        self.wait_until(lambda output: text in output, repr(text))

    def wait_until(self, condition: Callable[[str], bool], name: str = 'the condition') -> None:
        """Wait for a condition of the console output."""
        def is_met() -> bool:
            met = condition(self.output)
            assert met or self.is_running(), f'ended before {name}:\n{self.output}'
            return met

        wait_until(is_met, name, output=lambda: self._log.stat().st_size,
                   work=lambda: work_of(self.pid))

    def is_running(self) -> bool:
        """Return whether the process is running."""
        return self._process.poll() is None

    def finish(self) -> int:
        """Wait for the end and return the exit status, -N after signal N."""
        status = status_of(self._process, output=lambda: self._log.stat().st_size)
        assert 'Traceback' not in self.output, self.output
        return status

    def interrupt(self, number: int = signal.SIGINT) -> None:
        """Send a signal."""
        if number == signal.SIGKILL:
            self.left_behind = self.segments()
        self._process.send_signal(number)

    def segments(self) -> set[Path]:
        """Return the shared memory files of Fast DDS that the process has created."""
        return created_segments(self._process.pid)

    def kill(self) -> None:
        """End the process by SIGTERM, or by SIGKILL after 5 s."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(5)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


def created_segments(pid: int) -> set[Path]:
    """
    Return the segments of Fast DDS that a process has created; it holds their locks.

    It maps more, and it holds the locks of ports. The ports for data are numbered across all
    domains: a node that takes the port of a killed one still gets messages for that.
    """
    files = set[Path]()
    with suppress(OSError):  # it has ended
        for link in Path(f'/proc/{pid}/fd').iterdir():
            with suppress(FileNotFoundError):  # closed meanwhile
                files.add(link.readlink())
    return {path.with_name(path.name.removesuffix('_el')) for path in files
            if path.parent == _LOCKS and re.fullmatch('fast(rtps|dds)_[0-9a-f]{16}_el', path.name)}


def is_fastdds(file: Path) -> bool:
    """Return whether a file of the shared memory is of Fast DDS 2 or Fast DDS 3."""
    return 'fastrtps_' in file.name or 'fastdds_' in file.name


def mapped_segments(pid: int) -> set[Path]:
    """Return the shared memory files of Fast DDS that a process uses."""
    try:
        maps = Path(f'/proc/{pid}/maps').read_text()
    except OSError:
        return set()
    files = {Path(line.split()[-1]) for line in maps.splitlines() if '/dev/shm/' in line}
    return {file for file in files if is_fastdds(file)}


def remove_unused(segments: set[Path]) -> None:
    """Remove shared memory files of Fast DDS that no process uses."""
    if segments:
        used = set[Path]().union(*(mapped_segments(int(folder.name)) for folder in
                                   Path('/proc').glob('[0-9]*')))
        for path in segments - used:
            for name in (path.name, f'{path.name}_el', f'sem.{path.name}_mutex'):
                with suppress(PermissionError):
                    path.with_name(name).unlink(missing_ok=True)


def _ports(domain: int) -> set[Path]:
    """Return the ports of Fast DDS in a domain, also those that killed processes have left."""
    names = {f'{fast}_port{7400 + 250 * domain + number}'
             for fast in ('fastrtps', 'fastdds') for number in range(250)}
    return {path for path in _LOCKS.glob('fast*_port*') if path.name in names}


def executable(name: str) -> str:
    """Return the path of an executable: where ``ros2 run`` finds it, else beside python."""
    try:
        installed = Path(get_package_prefix('opencv_tools'), 'lib', 'opencv_tools', name)
        if installed.exists():
            return str(installed)
    except PackageNotFoundError:  # an editable installation has no resource index
        pass
    beside = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get('PATH', '')))
    return str(shutil.which(name, path=beside))


@pytest.fixture(autouse=True, scope='session')
def _no_unmarked_process() -> Iterator[None]:
    """Fail a test that starts a process without the mark ``process``."""
    start_process = subprocess.Popen.__init__

    def _start(*arguments: Any, **keywords: Any) -> None:
        frame = sys._getframe(1)
        while frame.f_back and frame.f_code.co_filename == subprocess.__file__:
            frame = frame.f_back
        # Libraries may start processes: matplotlib lists the fonts once.
        if not _may_start_processes and Path(frame.f_code.co_filename).is_relative_to(
                Path(__file__).parent):
            pytest.fail('a test that starts a process needs the mark pytest.mark.process')
        start_process(*arguments, **keywords)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subprocess.Popen, '__init__', _start)
        yield


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[Any]:
    """Note whether the test may start processes, also in its fixtures."""
    global _may_start_processes
    _may_start_processes = item.get_closest_marker('process') is not None
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown() -> Iterator[Any]:
    """Check that a test has changed nothing that later tests and processes would inherit."""
    global _inherited_before
    result = yield
    before, _inherited_before = _inherited_before, _inherited()
    assert _inherited_before == before
    return result


def pytest_configure() -> None:
    """Keep the standard error for the stacks of a test that hangs."""
    global _stderr
    _stderr = os.dup(2)


def pytest_runtest_logstart() -> None:
    """Watch over the tests; the option of pytest starts a thread for each one."""
    global _armed_at
    if time.monotonic() > _armed_at + _ARM_SECONDS:
        faulthandler.dump_traceback_later(HANG_SECONDS, exit=True, file=_stderr)
        _armed_at = time.monotonic()


def pytest_unconfigure() -> None:
    """End the watch."""
    faulthandler.cancel_dump_traceback_later()


@pytest.hookimpl(optionalhook=True)  # there may be no xdist
def pytest_xdist_setupnodes(config: pytest.Config, specs: list[Any]) -> None:
    """Start each worker in namespaces of its own, apart from all other nodes of this machine."""
    reason = own_namespaces.reason_against()
    if reason:
        config.get_terminal_writer().line(
            f'the tests share /dev/shm and the loopback with other nodes: {reason}')
        return
    for spec in specs:
        spec.python = shlex.join([*own_namespaces.PREFIX, sys.executable])


@pytest.hookimpl(tryfirst=True)  # before -m leaves out tests by their marks
def pytest_collection_modifyitems(
        config: pytest.Config, items: list[pytest.Item]) -> None:
    """
    Mark tests with ``process`` by their fixtures and folders, and mix the files for workers.

    After the first cases of a test with the mark ``quick_cases`` the others are ``thorough``.
    """
    cases: Counter[str] = Counter()
    for item in items:
        if mark := item.get_closest_marker('quick_cases'):
            cases[item.nodeid.partition('[')[0]] += 1
            if cases[item.nodeid.partition('[')[0]] > mark.args[0]:
                item.add_marker(pytest.mark.thorough)
    if 'PYTEST_XDIST_WORKER' in os.environ:
        # Tests that wait for processes run beside tests that compute.
        items.sort(key=lambda item: hashlib.sha256(item.path.name.encode()).digest())
    if 'OPENCV_TOOLS_ONLY' in os.environ:  # the tests that thorough.py runs again
        only = Path(os.environ['OPENCV_TOOLS_ONLY']).read_text().splitlines()
        config.hook.pytest_deselected(items=[item for item in items if item.nodeid not in only])
        items[:] = [item for item in items if item.nodeid in only]
    for item in items:
        if item.path.parent.name in OWN_COMMAND or (
                {'start', 'count', 'prefix', 'shared'} & set(getattr(item, 'fixturenames', ()))):
            item.add_marker(pytest.mark.process)


@contextmanager
def free_domain() -> Iterator[int]:
    """Reserve a ROS domain that no other test on this machine uses."""
    for count in itertools.islice(_domains, 1000):
        number = 1 + count % 100
        path = _LOCKS / f'opencv_tools_test_domain_{number}'
        lock = _lock(path)
        if lock is not None:
            try:
                # A port of a killed process has a queue of its own size, and may be given up.
                remove_unused(_ports(number))
                yield number
                assert not _ports(number) & mapped_segments(os.getpid()), (
                    'a node in this process was not destroyed')
            finally:
                with suppress(PermissionError):  # of another user, who made it
                    path.unlink()
                os.close(lock)
            return
    pytest.fail('every ROS domain is in use')


def _lock(path: Path) -> int | None:
    """Open and lock a file; None if another process has locked it."""
    for flags in (os.O_RDONLY, os.O_RDONLY | os.O_CREAT | os.O_EXCL):
        try:
            file = os.open(path, flags | os.O_NOFOLLOW, 0o644)
        except OSError:
            continue
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if path.stat().st_ino == os.fstat(file).st_ino:  # else it was removed meanwhile
                return file
        except OSError:
            pass
        os.close(file)
        return None
    return None


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Reserve a local ROS domain for the test."""
    with free_domain() as number:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(number))
        yield number


@pytest.fixture(autouse=True, scope='session')
def _environment(request: pytest.FixtureRequest,
                 tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Set the environment of all tests; one that has no domain can create no node."""
    # Kept between runs for the fonts that matplotlib looks for.
    home = request.config.rootpath / '.pytest_cache' / 'home'
    home.mkdir(parents=True, exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_HOME', str(tmp_path_factory.getbasetemp() / 'ros_home'))
        patch.setenv('HOME', str(home))
        patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        patch.setenv('ROS_DOMAIN_ID', 'none, as the test does not use the fixture `domain`')
        yield


@pytest.fixture(autouse=True)
def _domain_of_processes(request: pytest.FixtureRequest) -> None:
    """Reserve a domain for a test that starts processes."""
    if _may_start_processes:
        request.getfixturevalue('domain')


@pytest.fixture
def other_domain() -> Iterator[int]:
    """Reserve a second ROS domain."""
    with free_domain() as number:
        yield number


@pytest.fixture
def start(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    """
    Return a function that starts executables or examples; all of them end with the test.

    A node is a copy of a process that has imported its modules, see `prepared`. With the mark
    ``fresh``, or within another command, it is a process of its own from the beginning.

    Keywords are parameters. Positional arguments go to the command line unchanged. ``within`` is
    the prefix of the command; it must replace itself by ``exec``.
    """
    processes: list[NodeProcess] = []
    is_prepared = request.node.get_closest_marker('fresh') is None

    def _start(name: str, *words: str, within: Sequence[str] = (),
               **parameters: object) -> NodeProcess:
        given = [f'{key}:={value}' for key, value in parameters.items()]
        program = [sys.executable, str(EXAMPLES / name)] if name.endswith('.py') else [
            executable(name)]
        command = [*within, *program, *words, '--ros-args',
                   *itertools.chain.from_iterable(('-p', assignment) for assignment in given)]
        log = tmp_path / f'{name}_{len(processes)}.log'
        processes.append(NodeProcess(command, log, dict(os.environ), is_prepared))
        return processes[-1]

    yield _start
    for process in processes:
        if process.is_running():  # pytest shows it where the test failed
            print(process.output[-5000:])
        process.kill()
    remove_unused(set[Path]().union(*(process.left_behind for process in processes)))


@pytest.fixture
def prefix() -> Path:
    """Return the folder into which colcon has installed the package."""
    try:
        return Path(get_package_prefix('opencv_tools'))
    except PackageNotFoundError:
        if 'COLCON' in os.environ:
            raise
        pytest.skip('colcon has not installed the package; make test does, and runs this')


@pytest.fixture
def mount_namespace() -> tuple[str, ...]:
    """Return the prefix of a command that runs in its own mount namespace."""
    command = ('unshare', '--mount', *(() if os.getuid() == 0 else ('--user', '--map-root-user')))
    probe = subprocess.run([*command, 'mount', '-t', 'tmpfs', 'none', '/dev/shm'],
                           capture_output=True, text=True, check=False)
    if probe.returncode:
        pytest.skip(f'no mount namespace here: {probe.stderr}')
    return command


def destroy(node: Node) -> None:
    """
    Destroy a node and its context.

    Fast DDS 2.14 of PyPI waits for ever if another node of this process is destroyed while it
    learns that this one has ended, so this waits a moment.
    """
    node.destroy_node()
    rclpy.shutdown(context=node.context)
    pause(0.03)


@pytest.fixture
def node(domain: int) -> Iterator[Node]:
    """Create a plain rclpy node in this process."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    plain = Node('plain', context=context)
    yield plain
    destroy(plain)


@pytest.fixture
def camera(domain: int) -> Iterator[Node]:
    """Create a second node, ``/front/camera``, which other nodes have to discover."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    publishing = Node('camera', context=context, namespace='/front')
    yield publishing
    destroy(publishing)


@pytest.fixture
def tell(capsys: pytest.CaptureFixture[str]) -> Callable[[str], None]:
    """Return a function that prints a figure of a passing test."""
    def _tell(text: str) -> None:
        with capsys.disabled():
            print(f'\n{text}')

    return _tell


class CountingExecutor(SingleThreadedExecutor):
    """An executor that counts the callbacks it has found ready, except those of timers."""

    ready = 0

    def wait_for_ready_callbacks(self, *arguments: Any, **keywords: Any) -> Any:
        found = super().wait_for_ready_callbacks(*arguments, **keywords)
        self.ready += not isinstance(found[1], Timer)
        return found


@contextmanager
def executor_of(node: Node) -> Iterator[CountingExecutor]:
    """
    Create an executor of a node for a while.

    One that ends by an exception of a callback uses the node until it is shut down.
    """
    executor = CountingExecutor(context=node.context)
    executor.add_node(node)
    try:
        yield executor
    finally:
        executor.shutdown()


@contextmanager
def spinning(executor: Executor) -> Iterator[None]:
    """
    Spin an executor in a thread for a while, then shut it down.

    ``shutdown`` of rclpy 7.1 triggers a guard condition and destroys it, which a thread that is
    about to wait misses for ever. So a future ends the spinning before.
    """
    ended = Future()
    thread = Thread(target=executor.spin_until_future_complete, args=(ended,))
    thread.start()
    try:
        yield
    finally:
        ended.set_result(None)
        thread.join()
        executor.shutdown()


def spin_until(node: Node, condition: Callable[[], bool], name: str = 'the condition',
               **counters: Callable[[], object]) -> None:
    """
    Spin a node until a condition holds; see `waiting.Watch`.

    Without a counter, what the node receives must not stand still.
    """
    with executor_of(node) as executor:
        counters = counters or {'received': lambda: executor.ready}
        wait_until(condition, name, partial(executor.spin_once, timeout_sec=0.05), **counters)


def call_service(node: Node, service_type: type, name: str, request: object) -> object:
    """
    Call a service and wait for the answer.

    rmw_fastrtps drops an answer when its server has not discovered the client after 100 ms. A busy
    machine takes longer at times, so the request is sent again every 5 s.
    """
    client = node.create_client(service_type, name)
    spin_until(node, client.service_is_ready)
    calls: list[tuple[float, Future]] = []

    def is_answered() -> bool:
        if not calls or time.monotonic() > calls[-1][0] + 5:
            calls.append((time.monotonic(), client.call_async(request)))
        return any(future.done() for _, future in calls)

    spin_until(node, is_answered)
    node.destroy_client(client)
    return next(future.result() for _, future in calls if future.done())


def set_parameters(node: Node, **values: object) -> str:
    """Set parameters of the publisher and return the reasons of refusals, or ''."""
    messages = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    answer = call_service(node, SetParameters, '/image_publisher/set_parameters',
                          SetParameters.Request(parameters=messages))
    assert len(answer.results) == len(values)
    return '; '.join(result.reason or 'no reason'
                     for result in answer.results if not result.successful)


@contextmanager
def disk_of(size: int) -> Iterator[None]:
    """Limit the size of files in bytes, like a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def read_pictures(folder: Path, suffix: str = '.png') -> list[np.ndarray]:
    """Read the images of a folder in the order of their names."""
    return [cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            for path in sorted(folder.glob(f'*{suffix}'))]


def recorded_files(folder: Path) -> list[Path]:
    """Return the recorded files in the order of their names."""
    return sorted(path for path in folder.glob('[!.]*') if path.name != 'manifest.jsonl')


def read_manifest(folder: Path) -> list[dict[str, Any]]:
    """Read the manifest and check it against the recorded files."""
    lines = [json.loads(line) for line in (folder / 'manifest.jsonl').read_text().splitlines()]
    for line in lines:
        content = (folder / line['file']).read_bytes()
        assert line['bytes'] == len(content), line
        assert line['sha256'] == hashlib.sha256(content).hexdigest(), line
    assert sorted(line['file'] for line in lines) == [path.name for path in recorded_files(folder)]
    return lines


def decode_clip(count: int = CLIP_FRAMES) -> list[np.ndarray]:
    """Decode the first frames of the clip, independently of the package."""
    import av
    with av.open(str(CLIP)) as container:
        return [cv2.cvtColor(frame.to_ndarray(), cv2.COLOR_YUV2BGR_I420)
                for frame in itertools.islice(container.decode(video=0), count)]
