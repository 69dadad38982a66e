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

"""From the command line to an exit status: start a node, spin it, end it cleanly."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
import re
import signal
import sys
import time
from types import FrameType
from typing import Protocol

from opencv_tools.ros import rcl
from opencv_tools.ros.command_line import check_ros_arguments
from opencv_tools.ros.log_folder import replace_log_folder
from opencv_tools.ros.parameters import describe_parameters, Parameter, ParameterError
from opencv_tools.ros.transport import HELP, Transport, transport_for_frames
from opencv_tools.standard_streams import discard_broken_streams, open_standard_streams
import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

# Exit statuses of both executables.
DONE = 0
FAILED = 1
BAD_USAGE = 2

_END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Python runs its signal handlers when the executor comes back to it, this often at least.
_SIGNAL_SECONDS = 0.1
_PATIENCE_SECONDS = 1.0


@dataclass(frozen=True)
class Program:
    """
    What ``--help`` says of an executable, and what is known of it before its node is there.

    :param name: of the executable.
    :param node: name of its node.
    :param description: what it does.
    :param parameters: of its node.
    :param example: of ROS arguments, for ``--help``.
    :param frame_bytes: tells from the command line how large the frames are that it will publish.
    """

    name: str
    node: str
    description: str
    parameters: Sequence[Parameter]
    example: str
    frame_bytes: Callable[[Sequence[str]], int] = lambda _: 0


class Runnable(Protocol):
    """
    A node that ends by itself or is ended.

    ``done`` gets the exit status when there is nothing more to do.
    """

    done: Future

    def close(self) -> int:
        """
        Finish what was begun, say how it went and let go of everything.

        :returns: the exit status.
        """


def run(
    program: Program, make_node: Callable[[Transport], Runnable], args: Sequence[str] | None,
    failures: tuple[type[Exception], ...],
) -> int:
    """
    Run a node until it is done, or until Ctrl-C, SIGTERM or SIGHUP.

    Once there is an exit status these signals change nothing, until somebody else handles them.

    :param program: the executable.
    :param make_node: makes the node, once ROS is up, and is told how frames go.
    :param args: command line with the program's name first; None for the process's own.
    :param failures: what making the node raises, with a sentence for the user, when it cannot do
        its job.
    :returns: the exit status: ``DONE``, ``FAILED`` or ``BAD_USAGE``.
    """
    open_standard_streams()
    logger = get_logger(program.name)
    args = list(sys.argv if args is None else args)
    signals = _Signals()
    try:
        remarks = check_ros_arguments(args, program.name, program.node, program.parameters)
        _parse_arguments(remove_ros_args(args), program)
        remark = replace_log_folder()
        if remark:
            logger.warning(remark)
        for remark in remarks:
            logger.error(remark)
        with transport_for_frames(program.frame_bytes(args)) as transport:
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
            logger.debug(transport.remark + (
                f'; messages go with the copies of rclpy: {rcl.reason_for_rclpy}'
                if rcl.reason_for_rclpy else ''))
            if transport.warning:
                logger.warning(transport.warning)
            node = make_node(transport)
        return _run(node, signals)
    except (ParameterError, ParameterException) as err:
        logger.error(str(err))
        return BAD_USAGE
    except failures as err:
        logger.error(str(err))
        return FAILED
    except KeyboardInterrupt:
        return FAILED  # asked again: what was begun is not finished
    except RuntimeError as err:
        if rclpy.ok():
            raise
        logger.error(_describe_bad_arguments(err))
        return BAD_USAGE
    finally:
        signals.end()
        rclpy.try_shutdown()


def keep_exit_status() -> None:
    """
    Ignore for the rest of the process what would change its exit status: signals, lost terminals.

    Python's own handlers go away while the interpreter shuts down, which takes half a second.
    """
    discard_broken_streams()
    for number in _END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


class _Signals:
    """
    Note SIGINT, SIGTERM and SIGHUP, the last unless it was ignored at the start, as by nohup.

    rclpy's own handlers shut ROS down at once, under the feet of a node that is being made or has
    frames to finish. Here the node is told to end while ROS still works.
    """

    def __init__(self) -> None:
        self._first_at = 0.0
        self._has_ended = False
        for number in _END_SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._receive)

    @property
    def received(self) -> bool:
        """Tell whether the node was asked to end."""
        return self._first_at > 0.0

    def end(self) -> None:
        """Ignore what comes from now on."""
        self._has_ended = True

    def _receive(self, _number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        self._first_at = self._first_at or now
        # ros2 launch sends SIGINT after the terminal did; who asks much later is tired of waiting.
        if now - self._first_at > _PATIENCE_SECONDS and not self._has_ended:
            raise KeyboardInterrupt


def _parse_arguments(args: list[str], program: Program) -> None:
    """Answer ``--help`` and refuse words that are no ROS arguments, by leaving the program."""
    parser = argparse.ArgumentParser(
        prog=program.name, description=program.description,
        formatter_class=argparse.RawTextHelpFormatter,
        usage=f'{program.name} [--ros-args -p NAME:=VALUE ...]',
        epilog=f'example:\n  {program.name} --ros-args {program.example}\n\n'
               f'parameters [default]:\n{describe_parameters(program.parameters)}\n\n{HELP}')
    _, rest = parser.parse_known_args(args[1:])
    if rest:
        parser.error(f'unrecognized arguments: {" ".join(rest)}{_remedy(rest, program)}')


def _remedy(words: Sequence[str], program: Program) -> str:
    """Describe how to write a parameter that was written as an option, such as ``--source 0``."""
    names = {parameter.name for parameter in program.parameters}
    for word, following in zip(words, [*words[1:], '']):
        option, _, value = word.partition('=')
        name = option.lstrip('-').removesuffix(':').replace('-', '_')
        if option.startswith('-') and name in names:
            value = value or ('' if following.startswith('-') else following) or 'VALUE'
            return f'; write --ros-args -p {name}:={value}'
    return ''


def _run(node: Runnable, signals: _Signals) -> int:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.done.add_done_callback(lambda _: executor.wake())
    try:
        while not (signals.received or node.done.done()):
            executor.spin_once(timeout_sec=_SIGNAL_SECONDS)
    finally:
        status = node.close()
        signals.end()
        node.destroy_node()
    return status


def _describe_bad_arguments(err: RuntimeError) -> str:
    """Say what rcl says of arguments, without its source lines, and how to write a parameter."""
    reason = re.sub(r', at \S+:[0-9]+', '', str(err))
    if 'parameter override' in reason:
        reason += ('; write -p NAME:=VALUE, and a value with braces, brackets or spaces in quotes '
                   """within quotes: -p 'NAME:="VALUE"'""")
    return f'these ROS arguments cannot be used: {reason}'
