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

"""A node that receives and publishes frames, the function of a filter, and start and end."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
import inspect
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.cv_bridge import CvBridgeError
from opencv_tools.frames.frame import Frame
from opencv_tools.frames.loan import LoanedFrame
from opencv_tools.frames.publisher import FramePublisher
from opencv_tools.frames.subscriber import FrameSubscriber
from opencv_tools.image.encodings import find_encoding
from opencv_tools.nodes.executable import Executable
from opencv_tools.nodes.run_node import ClosableNode, run
from opencv_tools.transport.fastdds.profile import FastDdsSetup
from opencv_tools.transport.scheduling import use_priority

#: Size in pixels for which memory is reserved by default: 1920x1080.
FRAME_SIZE = (1920, 1080)
_CHANNELS = 3


class ImageFunction:
    """
    Call a function with images and publish its results.

    A function with a parameter ``out`` that has no default fills an array with the shape and
    encoding of its image, as ``cv2.flip(image, 1, dst=out)`` does. That array is published unless
    the function returns another one.
    """

    def __init__(
        self, function: Callable[..., Any], arguments: Sequence[Any] = (),
        keywords: Mapping[str, Any] | None = None,
    ) -> None:
        """
        Look for the parameter ``out``.

        :param function: returns an image, several values of which the last one is an image, or
            None for no image.
        :param arguments: arguments after the image.
        :param keywords: arguments by name.
        """
        self._function = function
        self._arguments = arguments
        self._keywords = {**(keywords or {})}
        self._fills_out = 'out' not in self._keywords and _requires_out(function)

    def publish(self, frame: Frame, publisher: FramePublisher) -> None:
        """
        Apply the function to a frame and publish the result with the header of the frame.

        :raises CvBridgeError: the function returns something else than an image.
        """
        if not self._fills_out:
            image = self._call(frame)
            if image is not None:
                publisher.publish(image, frame)
            return
        rows, width = frame.image.shape[:2]
        height = find_encoding(frame.encoding).height(rows)
        with publisher.loan(height, width, frame.encoding, frame) as loan:
            image = self._fill(frame, loan)
            if image is not None:
                publisher.publish(image, frame)
                loan.give_back()

    def _fill(self, frame: Frame, loan: LoanedFrame) -> NDArray[Any] | None:
        """Fill a loan; return an image that is published instead, or None."""
        image = self._call(frame, out=loan.image)
        return None if image is loan.image else image

    def _call(self, frame: Frame, **out: NDArray[Any]) -> NDArray[Any] | None:
        result = self._function(frame.image, *self._arguments, **self._keywords, **out)
        image = result[-1] if isinstance(result, tuple) and result else result
        if image is None or isinstance(image, np.ndarray):
            return image
        raise CvBridgeError(f'the function returned {type(image).__name__}, not an array')


def _requires_out(function: Callable[..., Any]) -> bool:
    """Return whether a function has a parameter ``out`` without a default."""
    try:
        out = inspect.signature(function).parameters.get('out')
    except (TypeError, ValueError):  # functions in C have no signature
        return False
    return out is not None and out.default is out.empty and out.kind in (
        out.POSITIONAL_OR_KEYWORD, out.KEYWORD_ONLY)


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
        self._destroy_frames()
        return super().close()

    def destroy_node(self) -> None:
        """Unsubscribe and remove the publishers, then all else; a callback may call this."""
        try:
            self._destroy_frames()
        finally:
            super().destroy_node()

    def _destroy_frames(self) -> None:
        with ExitStack() as stack:  # all are closed, even if one raises an exception
            # The last ones are closed first: a callback may publish until its thread ends.
            for closables in (self._frame_publishers, self._frame_subscribers):
                while closables:
                    stack.callback(closables.pop().destroy)


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
        memory is reserved; (0, 0) for a node that publishes no frames.
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
