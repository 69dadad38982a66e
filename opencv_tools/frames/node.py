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

"""A node that receives and publishes frames, and its start and end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.frames.frame import Frame
from opencv_tools.frames.image_function import ImageFunction
from opencv_tools.frames.publisher import FramePublisher
from opencv_tools.frames.subscriber import FrameSubscriber
from opencv_tools.nodes.executable import Executable
from opencv_tools.nodes.run_node import ClosableNode, run
from opencv_tools.transport.fastdds.profile import FastDdsSetup
from opencv_tools.transport.scheduling import use_priority

#: Size in pixels for which memory is reserved by default: 1920x1080.
FRAME_SIZE = (1920, 1080)
_CHANNELS = 3


class FrameNode(ClosableNode):
    """
    A node of rclpy with two more methods, `receive_frames` and `publish_frames`.

    ``done`` is a future that ends `main` with its result as exit status.
    """

    def __init__(self, node_name: str, **options: Any) -> None:
        """
        Create the node.

        :param options: other arguments of ``rclpy.node.Node``.
        """
        super().__init__(node_name, **options)
        self._frame_publishers: list[FramePublisher] = []
        self._frame_subscribers: list[FrameSubscriber] = []

    def receive_frames(
        self, topic: str, callback: Callable[[Frame], object], **options: Any,
    ) -> FrameSubscriber:
        """
        Subscribe to an image topic.

        :param topic: name of the topic before remapping.
        :param callback: called with each `Frame`.
        :param options: other arguments of `FrameSubscriber`.
        :returns: the subscriber.
        """
        subscriber = FrameSubscriber(self, topic, callback, **options)
        self._frame_subscribers.append(subscriber)
        return subscriber

    def publish_frames(self, topic: str, **options: Any) -> FramePublisher:
        """
        Create a publisher of images.

        :param topic: name of the topic before remapping.
        :param options: other arguments of `FramePublisher`.
        :returns: the publisher.
        """
        publisher = FramePublisher(self, topic, **options)
        self._frame_publishers.append(publisher)
        return publisher

    def close(self) -> int:
        """
        Unsubscribe and remove the publishers; `main` calls this at the end.

        :returns: the exit status: the result of ``done``, 0 without one.
        """
        with ExitStack() as stack:  # all are closed, even if one raises an exception
            # The last ones are closed first: a callback may publish until its thread ends.
            for closables in (self._frame_publishers, self._frame_subscribers):
                while closables:
                    stack.callback(closables.pop().destroy)
        return super().close()


def main(
    create_node: Callable[[], FrameNode], args: Sequence[str] | None = None, *,
    frame_size: tuple[int, int] = FRAME_SIZE, priority: int = 0,
) -> int:
    """
    Run a node until it is done, or until Ctrl-C, SIGTERM or SIGHUP.

    :param create_node: class of the node, or a function that creates it. The middleware is
        configured before, so the process must not have created a node.
    :param args: command line, program name first; None for that of the process.
    :param frame_size: width and height in pixels of the largest published frame, for which shared
        memory is reserved.
    :param priority: real-time priority of the executor and of the threads that receive, from 1 to
        99; 0 for normal scheduling. Without the permission a warning has the remedy.
    :returns: the exit status: 0, or the result of ``done``; 2 for invalid ROS arguments.
    """
    name = getattr(create_node, '__name__', 'node')
    width, height = frame_size
    executable = Executable(
        name=name, node=name, priority=priority, frame_bytes=width * height * _CHANNELS)

    def create(_: FastDdsSetup) -> FrameNode:
        node = create_node()
        use_priority(priority)
        return node

    return run(executable, create, args, failures=())


def run_filter(
    function: Callable[..., NDArray[np.generic] | None], source: str, target: str, *,
    encoding: str = 'bgr8', name: str = 'img_filter', args: Sequence[str] | None = None,
) -> int:
    """
    Apply a function to the images of a topic and publish the results.

    :param function: called with an array, (h, w) or (h, w, c) and read-only; returns the array to
        publish, or None for no image. It is called only if the results have subscribers. If it has
        a parameter ``out`` without a default, it gets an array of the same shape to fill, see
        `FramePublisher.loan`.
    :param source: topic of the images before remapping.
    :param target: topic of the results before remapping.
    :param encoding: encoding of the arrays; '' for that of the messages.
    :param args: command line, program name first; None for that of the process.
    :returns: the exit status, see `main`.
    """
    def create_node() -> FrameNode:
        node = FrameNode(name)
        publisher = node.publish_frames(target)
        image_function = ImageFunction(function)

        def filter_frame(frame: Frame) -> None:
            if publisher.has_subscribers:
                image_function.publish(frame, publisher)

        node.receive_frames(source, filter_frame, encoding=encoding)
        return node

    return main(create_node, args)
