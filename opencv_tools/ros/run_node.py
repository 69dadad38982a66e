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

"""Entry point of the nodes: parse arguments, run the node, return an exit status."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
import re
import signal
import socket
import sys
from threading import Thread
import time
from types import FrameType
from typing import Protocol

from opencv_tools.ros import zero_copy
from opencv_tools.ros.command_line import check_ros_arguments
from opencv_tools.ros.fastdds.profile import configured_fastdds, ENVIRONMENT_HELP, FastDdsSetup
from opencv_tools.ros.log_folder import replace_log_folder
from opencv_tools.ros.parameters import describe_parameters, Parameter, ParameterError
from opencv_tools.ros.priority import explain_refusal
from opencv_tools.standard_streams import discard_broken_streams, open_standard_streams
import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

# Exit statuses of the nodes.
EXIT_OK = 0
EXIT_FAILURE = 1
EXIT_USAGE = 2

_END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_FORCE_QUIT_SECONDS = 1.0


@dataclass(frozen=True, kw_only=True)
class Executable:
    """
    Properties of an executable that are needed before its node exists.

    :param name: name of the executable.
    :param node: name of the node.
    :param description: purpose of the executable, for ``--help``.
    :param parameters: parameters of the node; None if they are not known, and other arguments may
        be given as well.
    :param example: example of ROS arguments, for ``--help``.
    :param frame_bytes: estimates the bytes of a published frame from the command line; 0 for an
        executable that publishes none.
    :param priority: reads the real-time priority from the command line; 0 for normal scheduling.
    """

    name: str
    node: str
    description: str
    parameters: Sequence[Parameter] | None
    example: str
    frame_bytes: Callable[[Sequence[str]], int] = lambda _: 0
    priority: Callable[[Sequence[str]], int] = lambda _: 0


class ClosableNode(Protocol):
    """
    A node that ends by itself or is closed.

    ``done`` gets the exit status when the node has nothing left to do.
    """

    done: Future

    def close(self) -> int:
        """
        Finish pending work, log a summary and release all resources.

        :returns: the exit status.
        """


def run(
    executable: Executable, create_node: Callable[[FastDdsSetup], ClosableNode],
    args: Sequence[str] | None, failures: tuple[type[Exception], ...],
) -> int:
    """
    Run a node until it is done, or until Ctrl-C, SIGTERM or SIGHUP.

    Signals that arrive after the node has ended do not change the exit status.

    :param executable: properties of the executable.
    :param create_node: creates the node after rclpy is initialised, given the Fast DDS setup.
    :param args: command line, program name first; None for the command line of the process.
    :param failures: exceptions of ``create_node`` whose message is logged as a failure.
    :returns: the exit status: ``EXIT_OK``, ``EXIT_FAILURE`` or ``EXIT_USAGE``.
    """
    open_standard_streams()
    logger = get_logger(executable.name)
    args = sys.argv if args is None else args
    signals = _Signals()
    try:
        node = _start(executable, create_node, args)
        return _run(node, signals)
    except (ParameterError, ParameterException) as err:
        logger.error(str(err))
        return EXIT_USAGE
    except failures as err:
        logger.error(str(err))
        return EXIT_FAILURE
    except KeyboardInterrupt:
        return EXIT_FAILURE  # a second request; pending work was not finished
    except RuntimeError as err:
        if rclpy.ok():
            raise
        logger.error(_describe_bad_arguments(err))
        return EXIT_USAGE
    finally:
        signals.end()
        rclpy.try_shutdown()


def keep_exit_status() -> None:
    """
    Ignore events that would change the exit status: signals and closed terminals.

    Python removes its own signal handlers while the interpreter shuts down, which takes half a
    second.
    """
    discard_broken_streams()
    for number in _END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


class _Signals:
    """
    Record SIGINT, SIGTERM and SIGHUP; SIGHUP stays ignored under nohup.

    rclpy's handlers shut down the context immediately, even while the node is starting or
    flushing frames. These handlers only record the time of the first signal.
    """

    def __init__(self) -> None:
        self._first_at = 0.0
        self._has_ended = False
        for number in _END_SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._receive)

    @property
    def received(self) -> bool:
        """Return whether the node was asked to end."""
        return self._first_at > 0.0

    def end(self) -> None:
        """Ignore signals from now on."""
        self._has_ended = True

    def _receive(self, _number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        self._first_at = self._first_at or now
        # ros2 launch repeats the SIGINT of the terminal. A much later signal forces an exit.
        if now - self._first_at > _FORCE_QUIT_SECONDS and not self._has_ended:
            raise KeyboardInterrupt


def _start(
    executable: Executable, create_node: Callable[[FastDdsSetup], ClosableNode],
    args: Sequence[str],
) -> ClosableNode:
    """Check the arguments, initialise rclpy and create the node; parameters as for ``run``."""
    logger = get_logger(executable.name)
    args = list(args)
    mistakes: list[str] = []
    if executable.parameters is not None:
        mistakes = check_ros_arguments(
            args, executable.name, executable.node, executable.parameters)
        _parse_arguments(remove_ros_args(args), executable, executable.parameters)
    log_warning = replace_log_folder()
    if log_warning:
        logger.warning(log_warning)
    for mistake in mistakes:
        logger.error(mistake)
    priority = executable.priority(args)
    refusal = explain_refusal(priority)
    if refusal:
        logger.warning(refusal)
    with configured_fastdds(executable.frame_bytes(args), priority) as fastdds:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        logger.debug(fastdds.summary + (
            f'; rclpy copies the messages: {zero_copy.reason_for_rclpy}'
            if zero_copy.reason_for_rclpy else ''))
        if fastdds.warning:
            logger.warning(fastdds.warning)
        return create_node(fastdds)


def _parse_arguments(
    args: list[str], executable: Executable, parameters: Sequence[Parameter],
) -> None:
    """Handle ``--help``; exit on arguments that are not ROS arguments."""
    parser = argparse.ArgumentParser(
        prog=executable.name, description=executable.description,
        formatter_class=argparse.RawTextHelpFormatter,
        usage=f'{executable.name} [--ros-args -p NAME:=VALUE ...]',
        epilog=f'example:\n  {executable.name} --ros-args {executable.example}\n\n'
               f'parameters [default]:\n{describe_parameters(parameters)}\n\n'
               f'{ENVIRONMENT_HELP}')
    _, unknown = parser.parse_known_args(args[1:])
    if unknown:
        parser.error(
            f'unrecognized arguments: {" ".join(unknown)}{_remedy(unknown, parameters)}')


def _remedy(words: Sequence[str], parameters: Sequence[Parameter]) -> str:
    """Return how to write a parameter that was given as an option such as ``--source 0``."""
    names = {parameter.name for parameter in parameters}
    for word, following in zip(words, [*words[1:], '']):
        option, _, value = word.partition('=')
        name = option.lstrip('-').removesuffix(':').replace('-', '_')
        if option.startswith('-') and name in names:
            value = value or ('' if following.startswith('-') else following) or 'VALUE'
            return f'; write --ros-args -p {name}:={value}'
    return ''


def _run(node: ClosableNode, signals: _Signals) -> int:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    # A task ends spin_once(); a mere wake-up does not.
    node.done.add_done_callback(lambda _: executor.create_task(bool))
    try:
        with _woken_by_signals(executor):
            while not (signals.received or node.done.done()):
                executor.spin_once()
    finally:
        try:
            status = node.close()
        finally:
            signals.end()
            node.destroy_node()
    return status


@contextmanager
def _woken_by_signals(executor: Executor) -> Iterator[None]:
    """Make the executor return at each signal, because Python's handlers run only then."""
    reader, writer = socket.socketpair()
    writer.setblocking(False)

    def wake() -> None:
        while reader.recv(1):
            executor.create_task(bool)

    thread = Thread(target=wake, name='signals', daemon=True)
    thread.start()
    previous = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(previous)
        writer.close()
        thread.join()
        reader.close()


def _describe_bad_arguments(err: RuntimeError) -> str:
    """Return an error message of rcl without source lines, with the syntax of a parameter."""
    reason = re.sub(r', at \S+:[0-9]+', '', str(err))
    if 'parameter override' in reason:
        reason += ('; write -p NAME:=VALUE, and a value with braces, brackets or spaces in quotes '
                   """within quotes: -p 'NAME:="VALUE"'""")
    return f'these ROS arguments cannot be used: {reason}'
