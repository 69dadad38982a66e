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
from collections.abc import Callable, Sequence
from dataclasses import dataclass
import re
import signal
import socket
import sys
from threading import Thread
import time
from types import FrameType
from typing import Any

from opencv_tools.logs import Log
from opencv_tools.nodes.command_line import check_ros_arguments
from opencv_tools.nodes.exit_timer import exit_after
from opencv_tools.nodes.log_folder import replace_log_folder
from opencv_tools.nodes.parameters import describe_parameters, Parameter
from opencv_tools.signals import handle_signals, ignore_signals
from opencv_tools.standard_streams import discard_broken_streams, open_standard_streams
from opencv_tools.topics.errors import ParameterError
from opencv_tools.transport import zero_copy
from opencv_tools.transport.fastdds.profile import (
    configured_fastdds, ENVIRONMENT_HELP, FastDdsSetup)
from opencv_tools.transport.scheduling import explain_refusal
from opencv_tools.version import add_version_option
import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

# Exit statuses of the nodes.
EXIT_OK = 0
EXIT_FAILURE = 1
EXIT_USAGE = 2

_FORCE_QUIT_SECONDS = 1.0
_DESTROY_SECONDS = 5  # usually 0.05; `ros2 launch` kills a node after 10


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


class ClosableNode(Node):
    """
    A node that ends by itself or is closed.

    ``done`` gets the exit status when the node has nothing left to do.
    """

    def __init__(self, node_name: str, **options: Any) -> None:
        """
        Create the node.

        :param node_name: name of the node.
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

    :param executable: properties of the executable.
    :param create_node: creates the node after rclpy is initialised, given the Fast DDS setup.
    :param args: command line, program name first; None for the command line of the process.
    :param failures: exceptions of ``create_node`` whose message is logged as a failure.
    :returns: the exit status: ``EXIT_OK``, ``EXIT_FAILURE`` or ``EXIT_USAGE``.
    """
    open_standard_streams()
    log = Log(get_logger(executable.name))
    args = sys.argv if args is None else args
    signals = _Signals()
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


class _Signals:
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


def _start(
    executable: Executable, create_node: Callable[[FastDdsSetup], ClosableNode],
    args: Sequence[str], signals: _Signals,
) -> ClosableNode:
    """Check the arguments, initialise rclpy and create the node; parameters as for ``run``."""
    log = Log(get_logger(executable.name))
    args = list(args)
    mistakes: list[str] = []
    if executable.parameters is not None:
        mistakes = check_ros_arguments(
            args, executable.name, executable.node, executable.parameters)
        _parse_arguments(remove_ros_args(args), executable, executable.parameters)
    log_warning = replace_log_folder()
    if log_warning:
        log.warning(log_warning)
    for mistake in mistakes:
        log.error(mistake)
    priority = executable.priority(args)
    refusal = explain_refusal(priority)
    if refusal:
        log.warning(refusal)
    frame_bytes = executable.frame_bytes(args)
    signals.are_recorded = True
    with configured_fastdds(frame_bytes, priority) as fastdds:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        log.debug(fastdds.summary + (
            f'; rclpy copies the messages: {zero_copy.reason_for_rclpy}'
            if zero_copy.reason_for_rclpy else ''))
        if fastdds.warning:
            log.warning(fastdds.warning)
        return create_node(fastdds)


def _parse_arguments(
    args: list[str], executable: Executable, parameters: Sequence[Parameter],
) -> None:
    """Handle ``--help`` and ``--version``; exit on arguments that are not ROS arguments."""
    parser = argparse.ArgumentParser(
        prog=executable.name, description=executable.description,
        formatter_class=argparse.RawTextHelpFormatter,
        usage=f'{executable.name} [--ros-args -p NAME:=VALUE ...]',
        epilog=f'example:\n  {executable.name} --ros-args {executable.example}\n\n'
               f'{describe_parameters(parameters)}\n\n'
               f'{ENVIRONMENT_HELP}')
    add_version_option(parser)
    _, unknown = parser.parse_known_args(args[1:])
    if unknown:
        parser.error(
            f'unrecognized arguments: {" ".join(unknown)}{_remedy(unknown, parameters)}')


def _remedy(words: Sequence[str], parameters: Sequence[Parameter]) -> str:
    """Return how to write a parameter, or a source, that was given as ``--source 0`` or ``0``."""
    names = {parameter.name for parameter in parameters}
    for word, following in zip(words, [*words[1:], '']):
        option, _, value = word.partition('=')
        name = option.lstrip('-').removesuffix(':').replace('-', '_')
        if option.startswith('-') and name in names:
            value = value or ('' if following.startswith('-') else following) or 'VALUE'
            return f'; write --ros-args -p {name}:={value}'
    if len(words) == 1 and 'source' in names and re.match('(?!-|.*:=).', words[0]):
        return f'; write --ros-args -p source:={words[0]}'
    return '; parameters are written --ros-args -p NAME:=VALUE'


def _run(node: ClosableNode, signals: _Signals) -> int:
    executor = SingleThreadedExecutor()
    executor.add_node(node)

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
