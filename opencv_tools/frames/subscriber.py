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

"""Subscriber of images as arrays."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Condition, current_thread, Thread

from opencv_tools.cv_bridge import CvBridgeError
from opencv_tools.frames.frame import Frame
from opencv_tools.image.cdr import WireMessage
from opencv_tools.image.errors import ImageError
from opencv_tools.image.text import printable
from opencv_tools.logs import Throttle
from opencv_tools.ros.subscriber.subscription import FrameSubscription
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo

_MAX_INFOS = 30  # calibrations that wait for their image
_NANO = 10**9

_Waiting = tuple[WireMessage, int, CameraInfo | None]


class FrameSubscriber:
    """
    Call a function with each frame of a topic, or with the newest one only.

    The quality of service follows the publishers. If no frames arrive, the log has the reason.
    """

    def __init__(
        self, node: Node, topic: str, callback: Callable[[Frame], object], *,
        encoding: str = 'bgr8', every: bool = False, depth: int = 10, threaded: bool = False,
        camera_info: bool = False, transport: str = 'auto',
    ) -> None:
        """
        Subscribe.

        :param node: node that receives the frames.
        :param topic: name of the image topic before remapping.
        :param callback: called with a `Frame`, one call at a time.
        :param encoding: encoding of ``frame.image``; '' for that of the messages.
        :param every: whether the callback gets every frame, in order. By default it gets the
            newest frame, and frames that arrive during a call are skipped.
        :param depth: number of frames that may wait if ``every`` is set; older frames are skipped
            when more arrive.
        :param threaded: whether the callback runs in a thread of its own, so that timers,
            services and parameters of the node are not delayed by it. Its exceptions are raised
            in the executor.
        :param camera_info: whether to wait for the calibration with the same stamp, from the topic
            ``camera_info`` beside the image topic.
        :param transport: ``auto``, ``raw``, ``compressed`` or ``shm``.
        :raises KeyError: the transport is unknown.
        """
        self._node = node
        self._log = node.get_logger()
        self._callback = callback
        self._encoding = encoding
        self._capacity = depth if every else 1
        self._throttle = Throttle()
        self._overwritten = 0
        #: Number of messages that could not be read or converted.
        self.failed = 0
        self._infos: dict[int, CameraInfo] = {}
        self._without_info: deque[tuple[WireMessage, int]] = deque()
        self._info_subscription = None
        self._waiting: deque[_Waiting] = deque()
        self._condition = Condition()
        self._is_closed = False
        self._error: BaseException | None = None  # raised by the callback in its thread
        self._thread: Thread | None = None
        if threaded:
            self._failure = node.create_guard_condition(self._raise_error)
            self._thread = Thread(target=self._run, name=f'frames of {topic}', daemon=True)
            self._thread.start()
        if camera_info:
            base = node.resolve_topic_name(topic).rpartition('/')[0]
            self._info_subscription = node.create_subscription(
                CameraInfo, f'{base}/camera_info', self._add_info, qos_profile_sensor_data)
        self._subscription = FrameSubscription(
            node, topic, transport, self._capacity, self._log, self._receive, self._count_failed,
            in_thread=threaded)

    @property
    def topic_name(self) -> str:
        """Name of the subscribed topic after remapping."""
        return self._subscription.topic_name

    @property
    def skipped(self) -> int:
        """Return the number of frames that newer ones replaced, or that were lost."""
        return self._overwritten + self._subscription.losses.count

    def destroy(self) -> None:
        """
        Unsubscribe, and wait until a running call of the callback has returned.

        The callback itself may call this, also in its thread. An exception of the callback that
        the executor has not raised is raised here.
        """
        self._subscription.destroy()
        if self._info_subscription is not None:
            self._node.destroy_subscription(self._info_subscription)
            self._info_subscription = None
        with self._condition:
            self._is_closed = True
            self._condition.notify_all()
        if self._thread is not None and self._thread is not current_thread():
            self._thread.join()
            self._raise_error()

    def _receive(self, message: WireMessage, receive_ns: int) -> None:
        if self._info_subscription is None:
            self._deliver(message, receive_ns, None)
            return
        self._without_info.append((message, receive_ns))
        while len(self._without_info) > self._capacity:
            self._without_info.popleft()
            self._overwritten += 1
        self._pair()

    def _add_info(self, info: CameraInfo) -> None:
        self._infos[info.header.stamp.sec * _NANO + info.header.stamp.nanosec] = info
        while len(self._infos) > _MAX_INFOS:
            del self._infos[next(iter(self._infos))]
        self._pair()

    def _pair(self) -> None:
        """Deliver the images whose calibration has arrived; older images are skipped."""
        for index in reversed(range(len(self._without_info))):
            if _stamp(self._without_info[index][0]) in self._infos:
                break
        else:
            return
        for _ in range(index + 1):
            message, receive_ns = self._without_info.popleft()
            info = self._infos.pop(_stamp(message), None)
            if info is None:
                self._overwritten += 1
            else:
                self._deliver(message, receive_ns, info)

    def _deliver(self, message: WireMessage, receive_ns: int, info: CameraInfo | None) -> None:
        if self._thread is None:
            self._call(message, receive_ns, info)
            return
        with self._condition:
            self._waiting.append((message, receive_ns, info))
            while len(self._waiting) > self._capacity:
                self._waiting.popleft()
                self._overwritten += 1
            self._condition.notify()

    def _run(self) -> None:
        """Call the callback with waiting frames until the subscriber is closed or it fails."""
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._waiting or self._is_closed)
                if self._is_closed:
                    self._node.destroy_guard_condition(self._failure)
                    return
                waiting = self._waiting.popleft()
            try:
                self._call(*waiting)
            except BaseException as err:  # noqa: B902 (the executor raises it)
                self._error = err
                self._failure.trigger()
                return
            del waiting  # release the message before the next wait

    def _raise_error(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _call(self, message: WireMessage, receive_ns: int, info: CameraInfo | None) -> None:
        try:
            frame = Frame(message, self._encoding, receive_ns, info)
        except (CvBridgeError, ImageError) as err:
            self._count_failed(err)
        else:
            self._callback(frame)

    def _count_failed(self, err: ImageError | CvBridgeError) -> None:
        """Count and log a message that cannot be read or converted."""
        self.failed += 1
        if self._throttle.passes():
            self._log.warning(f'frame of {self.topic_name} skipped: {printable(err)}')


def _stamp(message: WireMessage) -> int:
    return message.header.sec * _NANO + message.header.nanosec
