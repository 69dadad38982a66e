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

"""Subscriber that passes frames to a function as arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from opencv_tools.base.logs import Log
from opencv_tools.base.rate_limit import MAX_RATE, RateLimit
from opencv_tools.cv_bridge import CvBridgeError
from opencv_tools.frames.frame import check_target, Frame
from opencv_tools.image.errors import EncodingError, ImageError
from opencv_tools.rectification import Rectifier
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.options import SubscriptionOptions
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.topics.subscription import FrameSubscription
from rclpy.node import Node


class FrameSubscriber:
    """
    Call a function with each frame of a topic, or with the newest one only.

    The quality of service follows the publishers. If no frames arrive, the log has the reason.
    """

    def __init__(
        self, node: Node, topic: str, callback: Callable[[Frame], object], *,
        encoding: str = 'bgr8', every: bool = False, depth: int = 10, threaded: bool = False,
        camera_info: bool = False, transport: str = 'auto', max_rate: float = 0.0,
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
            ``camera_info`` beside the image topic, for ``Frame.rectified``.
        :param transport: ``auto``, ``raw``, ``compressed``, ``video`` or ``shm``.
        :param max_rate: maximum rate of the calls in Hz, by the stamps of the frames; 0 for no
            limit. The frames between are skipped, also if ``every`` is set.
        :raises ParameterError: an argument is invalid.
        """
        flags = {'every': every, 'threaded': threaded, 'camera_info': camera_info}
        _check(callback, encoding, flags, depth, max_rate)
        self._log = Log(node.get_logger())
        self._callback = callback
        self._encoding = encoding
        self._rectifier = Rectifier()
        self._rate_limit = RateLimit(max_rate)
        self._left_out = 0  # frames above the rate
        #: Number of messages that could not be read or converted.
        self.failed = 0
        self._subscription = FrameSubscription(
            node, topic, self._log, self._receive, self._count_failed, SubscriptionOptions(
                transport=transport, depth=depth if every else 1, threaded=threaded,
                camera_info=camera_info))
        self._subscription.start()

    @property
    def topic_name(self) -> str:
        """Name of the subscribed topic after remapping."""
        return self._subscription.topic_name

    @property
    def skipped(self) -> int:
        """Return the number of frames that were skipped or lost."""
        account = self._subscription.account
        return self._left_out + account.skipped + account.lost

    @property
    def before(self) -> int:
        """Return the number of frames that were sent before the first received one."""
        return self._subscription.account.before

    def destroy(self) -> None:
        """
        Unsubscribe, and wait until a running call of the callback has returned.

        The callback itself may call this, also in its thread. An exception of the callback that
        the executor has not raised is raised here.
        """
        self._subscription.destroy()

    def _receive(self, received: ReceivedMessage) -> None:
        if not self._rate_limit.selects(received.stamp_ns, received.receive_ns):
            self._left_out += 1
            return
        try:
            frame = Frame(received.image, self._encoding, received.receive_ns,
                          received.camera_info, self._rectifier)
        except (CvBridgeError, ImageError) as err:
            self._count_failed(err)
        else:
            self._callback(frame)

    def _count_failed(self, err: ImageError | CvBridgeError) -> None:
        """Count and log a message that cannot be read or converted."""
        self.failed += 1
        self._log.warning(f'frame of {self.topic_name} skipped: {err}', every=1.0, key='skipped')


def _check(
    callback: object, encoding: str, flags: Mapping[str, object], depth: int, max_rate: float,
) -> None:
    """Check the arguments of a subscriber; those of the subscription are checked there."""
    for name, value in flags.items():
        if type(value) is not bool:
            raise ParameterError(f'{name} is {value!r}: give True or False')
    if not callable(callback):
        raise ParameterError(f'callback is {callback!r}: give a function of a Frame')
    try:
        check_target(encoding)
    except (AttributeError, EncodingError, TypeError) as err:
        raise ParameterError(f'encoding is {encoding!r}: {err}') from err
    if type(depth) is not int or depth < 1:
        raise ParameterError(f'depth is {depth!r}: give a number of frames, at least 1')
    if type(max_rate) not in (int, float) or not 0 <= max_rate <= MAX_RATE:
        raise ParameterError(f'max_rate is {max_rate!r}: give a rate in Hz from 0 to '
                             f'{MAX_RATE:g}, 0 for no limit')
