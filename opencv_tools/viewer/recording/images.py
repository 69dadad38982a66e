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

"""The frames of a topic, received for a bag."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import NamedTuple

from opencv_tools.base.logs import Log
from opencv_tools.image.errors import ImageError
from opencv_tools.nodes.bag_messages import BagMessages
from opencv_tools.recording.bag_file import RecordedMessage
from opencv_tools.recording.message_frame import MessageFrame
from opencv_tools.topics.options import SubscriptionOptions
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.topics.subscription import FrameSubscription
from rclpy.node import Node

# Frames of a topic that the middleware keeps while the executor is busy.
_DEPTH = 64
# Frames that stay in shared memory while they wait to be written; more are copied.
_MAX_VIEWS = 2


class Topic(NamedTuple):
    """
    An image topic to record.

    :param name: name of the topic, without the end of a transport.
    :param transport: transport as the pages receive it; ``auto`` prefers compressed images.
    """

    name: str
    transport: str


class RecordedImages:
    """Receive each frame of a topic, and the camera_info beside it, in the executor."""

    def __init__(
        self, node: Node, topic: Topic, log: Log,
        on_frame: Callable[[MessageFrame], object],
        on_message: Callable[[RecordedMessage], object],
    ) -> None:
        """
        Subscribe.

        :param on_frame: called with each frame, as it was received.
        :param on_message: called with each camera_info, as it was received.
        :raises ParameterError: the topic cannot be subscribed to.
        """
        self.received = self.unreadable = 0
        self.heard_at = time.monotonic()  # time of the last frame, or of the beginning
        self._on_frame = on_frame
        self._subscription = FrameSubscription(
            node, topic.name, log, self._receive, self._count_unreadable,
            SubscriptionOptions(transport=topic.transport, depth=_DEPTH, prefers_compressed=True,
                                decodes_video=False, max_views=_MAX_VIEWS))
        self._messages = BagMessages(node, self._subscription.topic_name, log, on_message)
        self._subscription.start()

    @property
    def lost(self) -> int:
        """Return the number of frames that were published, but did not arrive."""
        account = self._subscription.account
        return account.lost + account.skipped

    def explain_briefly(self) -> str:
        """Return the reason why no frame arrives, without the remedies, which the log has."""
        return self._subscription.explain_no_frames().partition('; ')[0]

    def close(self, has_room: Callable[[], bool]) -> int:
        """
        Pass on what was received until now, and unsubscribe.

        :param has_room: returns whether another frame can be recorded.
        :returns: number of frames that were not passed on.
        """
        unprocessed = self._subscription.close(has_room)
        self._messages.close()
        return unprocessed

    def _receive(self, received: ReceivedMessage) -> None:
        try:
            frame = self._messages.frame(received, self._subscription.topic_name)
        except ImageError as err:
            self._count_unreadable(err)
            return
        self.received += 1
        self.heard_at = time.monotonic()
        self._on_frame(frame)

    def _count_unreadable(self, _: ImageError) -> None:
        self.unreadable += 1
        self.heard_at = time.monotonic()
