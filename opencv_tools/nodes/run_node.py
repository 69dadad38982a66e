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

"""Entry point of the nodes: arguments, log folder, signals, the end and the exit status."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
import ctypes
import os
from pathlib import Path
import re
import signal
import socket
import sys
from tempfile import mkdtemp
from threading import Thread
import time
from types import FrameType
from typing import Any

from opencv_tools.base.logs import Log
from opencv_tools.base.signals import handle_signals, ignore_signals
from opencv_tools.base.standard_streams import discard_broken_streams, open_standard_streams
from opencv_tools.nodes.executable import Executable
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.executor import FrameExecutor
from opencv_tools.topics.timers import create_steady_timer
from opencv_tools.transport import zero_copy
from opencv_tools.transport.fastdds.profile import configured_fastdds, FastDdsSetup
from opencv_tools.transport.scheduling import explain_refusal
import rclpy
from rclpy.exceptions import ParameterException
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

_FORCE_QUIT_SECONDS = 1.0


class NodeSignals:
    """
    Record SIGINT, SIGTERM and SIGHUP; SIGHUP stays ignored under nohup.

    rclpy's handlers shut down the context immediately, even while the node is starting or
    flushing frames. These handlers only record the time of the first signal, from the moment that
    something has to be finished. A signal before raises KeyboardInterrupt.
    """

    def __init__(self) -> None:
        self._first_at = 0.0
        self._has_ended = False
        #: Whether signals are only recorded.
        self.are_recorded = False
        #: Called by the handler of a much later signal; None to raise KeyboardInterrupt.
        self.force: Callable[[], object] | None = None
        # Signals that arrive before the executor waits are kept in this socket.
        self._reader, self._writer = socket.socketpair()
        self._writer.setblocking(False)
        self._waker: Thread | None = None
        self._previous = signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
        handle_signals(self._receive, ignorable=(signal.SIGHUP,))

    @property
    def received(self) -> bool:
        """Return whether the node was asked to end."""
        return self._first_at > 0.0

    def wake(self, end_spin: Callable[[], object]) -> None:
        """End the spinning at each signal, because Python's handlers run only then."""
        def wake() -> None:
            while self._reader.recv(1):
                end_spin()

        self._waker = Thread(target=wake, name='signals', daemon=True)
        self._waker.start()

    def end(self) -> None:
        """Ignore signals from now on."""
        self._has_ended = True
        ignore_signals()
        if self._writer.fileno() < 0:
            return
        signal.set_wakeup_fd(self._previous)
        self._writer.close()
        if self._waker:
            self._waker.join()
        self._reader.close()

    def _receive(self, _number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        self._first_at = self._first_at or now
        if not self.are_recorded:
            raise KeyboardInterrupt
        # ros2 launch repeats the SIGINT of the terminal. A much later signal forces an exit.
        if now - self._first_at > _FORCE_QUIT_SECONDS and not self._has_ended:
            if self.force is None:
                raise KeyboardInterrupt
            self.force()


_VARIABLE = 'ROS_LOG_DIR'


def replace_log_folder() -> str:
    """
    Set a temporary log folder if the default one is not writable.

    :returns: a sentence about the temporary folder, '' if the default one is used.
    """
    folder = _log_folder()
    if folder and _is_writable(folder):
        return ''
    reason = (f'{folder} cannot be written' if folder
              else 'there is no home directory, HOME is unset')
    try:
        temporary = mkdtemp(prefix='opencv_tools_log_')
    except OSError:
        return ''  # rcl reports the error
    os.environ[_VARIABLE] = temporary
    return f'{reason}: ROS logs are written to {temporary}; set {_VARIABLE} to use another folder'


def _log_folder() -> Path | None:
    """Return the folder that rcl uses, from ROS_LOG_DIR, ROS_HOME or HOME."""
    for variable, below in ((_VARIABLE, ''), ('ROS_HOME', 'log'), ('HOME', '.ros/log')):
        if os.environ.get(variable):
            return Path(os.environ[variable], below)
    return None


def _is_writable(folder: Path) -> bool:
    """Return whether a folder is writable, after it is created if needed."""
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return folder.is_absolute() and os.access(folder, os.W_OK | os.X_OK)


_SIGEV_THREAD = 2


class _Notification(ctypes.Structure):
    """``struct sigevent`` of POSIX."""

    _fields_ = [('value', ctypes.c_void_p), ('signal', ctypes.c_int), ('notify', ctypes.c_int),
                ('function', ctypes.c_void_p), ('attributes', ctypes.c_void_p),
                ('reserved', ctypes.c_byte * 32)]


class _Interval(ctypes.Structure):
    """``struct itimerspec`` of POSIX: the period, and the time until the first expiration."""

    _fields_ = [(name, ctypes.c_long) for name in (
        'period_seconds', 'period_nanoseconds', 'seconds', 'nanoseconds')]


@contextmanager
def exit_after(seconds: int, status: int) -> Iterator[None]:
    """
    End the process if the block takes longer, also if no thread can run Python meanwhile.

    A timer of POSIX calls ``_exit`` in a thread of its own. Without such timers there is no limit.

    :param seconds: limit in seconds.
    """
    library = ctypes.CDLL(None)
    timer = ctypes.c_void_p()
    try:
        create, start, delete = (getattr(library, f'timer_{name}') for name in (
            'create', 'settime', 'delete'))
    except AttributeError:
        yield
        return
    at_limit = _Notification(value=status, notify=_SIGEV_THREAD, function=ctypes.cast(
        library._exit, ctypes.c_void_p))
    has_timer = create(time.CLOCK_MONOTONIC, ctypes.byref(at_limit), ctypes.byref(timer)) == 0
    if has_timer:
        start(timer, 0, ctypes.byref(_Interval(seconds=seconds)), None)
    try:
        yield
    finally:
        if has_timer:
            delete(timer)


# Exit statuses of the nodes.
EXIT_OK = 0
EXIT_FAILURE = 1
EXIT_USAGE = 2

_CLOCK_SECONDS = 3  # without a new time of /clock, after which this is logged
_DESTROY_SECONDS = 5  # usually 0.05; `ros2 launch` kills a node after 10


class ClosableNode(Node):
    """
    A node that ends by itself or is closed.

    ``done`` gets the exit status when the node has nothing left to do.
    """

    def __init__(self, node_name: str, **options: Any) -> None:
        """
        Create the node.

        :param options: other arguments of ``rclpy.node.Node``.
        """
        super().__init__(node_name, **options)
        self.done = Future()

    def hurry(self) -> None:
        """
        Leave pending work; called by the handler of a second signal, also during ``close``.

        :raises KeyboardInterrupt: the node has no other way to end soon.
        """
        raise KeyboardInterrupt

    def close(self) -> int:
        """
        Finish pending work, log a summary and release all resources.

        :returns: the exit status: the result of ``done``, ``EXIT_OK`` without one.
        """
        return int(self.done.result()) if self.done.done() else EXIT_OK


def run(
    executable: Executable, create_node: Callable[[FastDdsSetup], ClosableNode],
    args: Sequence[str] | None, failures: tuple[type[Exception], ...],
) -> int:
    """
    Run a node until it is done, or until Ctrl-C, SIGTERM or SIGHUP.

    Signals are ignored after the node has ended, so they do not change the exit status.

    :param create_node: creates the node after rclpy is initialised, given the Fast DDS setup.
    :param args: command line, program name first; None for the command line of the process.
    :param failures: exceptions of ``create_node`` whose message is logged as a failure.
    :returns: the exit status: ``EXIT_OK``, ``EXIT_FAILURE`` or ``EXIT_USAGE``.
    """
    open_standard_streams()
    log = Log(get_logger(executable.name))
    args = sys.argv if args is None else args
    signals = NodeSignals()
    try:
        node = _start(executable, create_node, args, signals)
        return _run(node, signals)
    except (ParameterError, ParameterException) as err:
        log.error(str(err))
        return EXIT_USAGE
    except failures as err:
        log.error(str(err))
        return EXIT_FAILURE
    except KeyboardInterrupt:
        # A second request leaves work undone. Before the node begins, there is none.
        return EXIT_FAILURE if signals.are_recorded else EXIT_OK
    except RuntimeError as err:
        if rclpy.ok():
            raise
        log.error(_describe_bad_arguments(err))
        return EXIT_USAGE
    finally:
        signals.end()
        rclpy.try_shutdown()
        discard_broken_streams()


def _start(
    executable: Executable, create_node: Callable[[FastDdsSetup], ClosableNode],
    args: Sequence[str], signals: NodeSignals,
) -> ClosableNode:
    """Check the arguments, initialise rclpy and create the node; parameters as for ``run``."""
    log = Log(get_logger(executable.name))
    mistakes = executable.check_arguments(args)
    log_warning = replace_log_folder()
    if log_warning:
        log.warning(log_warning)
    for mistake in mistakes:
        log.error(mistake)
    priority, frame_bytes = executable.read_start(args)
    refusal = explain_refusal(priority)
    if refusal:
        log.warning(refusal)
    signals.are_recorded = True
    with configured_fastdds(frame_bytes, priority) as fastdds:
        rclpy.init(args=list(args), signal_handler_options=SignalHandlerOptions.NO)
        log.debug(fastdds.summary + (
            f'; rclpy copies the messages: {zero_copy.reason_for_rclpy}'
            if zero_copy.reason_for_rclpy else ''))
        if fastdds.warning:
            log.warning(fastdds.warning)
        return create_node(fastdds)


class ClockWatch:
    """Log that simulated time does not begin, stands still, or goes on."""

    def __init__(self, node: Node, seconds: float = 1.0) -> None:
        """
        Look at the clock of a node with ``use_sim_time``; do nothing for others.

        :param seconds: seconds from one look to the next.
        """
        self._node = node
        self._last = self._looks = 0
        if node.get_parameter('use_sim_time').value:
            create_steady_timer(node, seconds, self._look)

    def _look(self) -> None:
        now, log = self._node.get_clock().now().nanoseconds, self._node.get_logger()
        if now != self._last and self._looks >= _CLOCK_SECONDS:
            log.info('simulated time goes on')
        self._looks = self._looks + 1 if now == self._last else 0
        self._last = now
        if self._looks == _CLOCK_SECONDS:
            log.warning(
                'use_sim_time is set, but ' + ('/clock stands still' if now else (
                    'nothing publishes /clock: start the simulator, play a bag with '
                    'clock:=true, or unset use_sim_time; frames have no stamp until then')))


def _run(node: ClosableNode, signals: NodeSignals) -> int:
    executor = FrameExecutor(node.context)
    executor.add_node(node)
    ClockWatch(node)

    def end_spin(_: Future | None = None) -> None:
        executor.create_task(bool)  # ends spin_once(); a mere wake-up does not

    node.done.add_done_callback(end_spin)
    signals.force = node.hurry
    signals.wake(end_spin)
    status = EXIT_FAILURE
    try:
        try:
            while not (signals.received or node.done.done()):
                executor.spin_once()
        finally:
            closed = node.close()
        status = closed
    finally:
        signals.end()
        node.done.remove_done_callback(end_spin)
        executor.shutdown()
        # Fast DDS 2.14 of PyPI waits for ever if it learns at this moment that another node ends:
        # its set_listener() waits until a time that overflows, with the mutex.
        with exit_after(_DESTROY_SECONDS, status):
            node.destroy_node()
    return status


def _describe_bad_arguments(err: RuntimeError) -> str:
    """Return an error message of rcl without source lines, with the syntax of a parameter."""
    reason = re.sub(r', at \S+:[0-9]+', '', str(err))
    if 'parameter override' in reason:
        reason += ('; write -p NAME:=VALUE, and a value with braces, brackets or spaces in quotes '
                   """within quotes: -p 'NAME:="VALUE"'""")
    return f'these ROS arguments cannot be used: {reason}'
