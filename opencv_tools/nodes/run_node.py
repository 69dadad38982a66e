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

from collections.abc import Callable, Sequence
import re
import sys
from typing import Any

from opencv_tools.logs import Log
from opencv_tools.nodes.executable import Executable
from opencv_tools.nodes.exit_timer import exit_after
from opencv_tools.nodes.log_folder import replace_log_folder
from opencv_tools.nodes.node_signals import NodeSignals
from opencv_tools.standard_streams import discard_broken_streams, open_standard_streams
from opencv_tools.topics.errors import ParameterError
from opencv_tools.transport import zero_copy
from opencv_tools.transport.fastdds.profile import configured_fastdds, FastDdsSetup
from opencv_tools.transport.scheduling import explain_refusal
import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

# Exit statuses of the nodes.
EXIT_OK = 0
EXIT_FAILURE = 1
EXIT_USAGE = 2

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

    :param executable: properties of the executable.
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


def _run(node: ClosableNode, signals: NodeSignals) -> int:
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
