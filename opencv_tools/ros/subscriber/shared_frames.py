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

"""Subscription to frames in shared memory, which takes over from the image topic and back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import RLock
import time

from opencv_tools.image.cdr import WireHeader, WireImage
from opencv_tools.image.errors import CdrError
from opencv_tools.logs import Log
from opencv_tools.ros.shared_frames.announcement import SUFFIX
from opencv_tools.ros.shared_frames.header import SharedFrame
from opencv_tools.ros.shared_frames.memory import MAX_DEPTH, process_memory
from opencv_tools.ros.shared_frames.pages import SharedMemoryError
from opencv_tools.ros.shared_frames.services import MAX_PUBLISHERS, SharedServices
from opencv_tools.ros.subscriber.lost_frames import LostFrames
from opencv_tools.ros.subscriber.shared_link import LinkState, SharedLink
from opencv_tools.ros.zero_copy import MessageInfo
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String


class SharedFrameSubscriber:
    """
    Receive the frames that publishers on this machine share.

    Frames are shared while all publishers of the topic do so. The sequence numbers of the messages
    on the image topic, which are also in the header of each shared frame, tell which frame
    follows which. So no frame is lost or doubled when a subscription changes from one to the
    other.
    """

    def __init__(
        self, node: Node, topic: str, *, depth: int | None, in_thread: bool, max_views: int,
        log: Log, losses: LostFrames, on_frame: Callable[[WireImage, int], None],
        on_broken: Callable[[CdrError], None], on_change: Callable[[], None],
        receive_messages: Callable[[], None],
    ) -> None:
        """
        Subscribe to the announcements.

        :param node: node that receives the frames.
        :param topic: name of the image topic before remapping.
        :param depth: number of frames that may wait; None for as many as possible.
        :param in_thread: whether to pass on shared frames in a thread of this object, not in the
            executor.
        :param max_views: number of frames that may stay in the shared memory; more are copied.
        :param log: log for the reasons why frames are not shared.
        :param losses: counter of frames that did not arrive.
        :param on_frame: called with a frame and its time of reception in nanoseconds of the system
            clock, with ``lock`` held.
        :param on_broken: called with the error of a frame that cannot be read.
        :param on_change: called in the executor when ``update`` should be called.
        :param receive_messages: calls ``receive`` with the messages of the image topic that wait;
            called in the executor.
        """
        #: Held while a frame is passed on.
        self.lock = RLock()
        self._node = node
        self._depth = MAX_DEPTH if depth is None else depth
        self._in_thread = in_thread
        self._max_views = max_views
        self._log = log
        self._losses = losses
        self._on_frame = on_frame
        self._on_broken = on_broken
        self._on_change = on_change
        self._receive_messages = receive_messages
        self._links: dict[bytes, SharedLink] = {}
        self._services = SharedServices(log)
        # Numbers of the last message and of the last shared one, by publisher.
        self._passed: dict[bytes, int] = {}
        self._shared: dict[bytes, int] = {}
        self._has_changed = False
        self._guard = node.create_guard_condition(self._wake)
        self._subscription = node.create_subscription(
            String, f'{node.resolve_topic_name(topic)}{SUFFIX}', self._read_announcement,
            QoSProfile(depth=MAX_PUBLISHERS, durability=DurabilityPolicy.TRANSIENT_LOCAL))

    def update(self, publishers: frozenset[bytes]) -> bool:
        """
        Open the shared frames of all publishers, or leave them if not all share.

        :param publishers: identifiers of the publishers of the image topic.
        :returns: whether all frames come from shared memory.
        """
        with self.lock:
            if self._links.keys() - publishers:
                self._receive_messages()  # they may precede the shared frames
            for publisher in self._links.keys() - publishers:
                self._drain(self._links[publisher])
                self._close(publisher)
            for numbers in (self._passed, self._shared):
                if len(numbers) > MAX_PUBLISHERS:
                    for publisher in numbers.keys() - publishers:
                        del numbers[publisher]
            are_shared = bool(publishers) and self._services.include(publishers)
            for publisher in publishers:
                link = self._links.get(publisher)
                if link is None and are_shared:
                    are_shared = self._open(publisher)
                elif link is not None and (
                        not are_shared or link.service != self._services.of(publisher)):
                    self._leave(link)
            return are_shared and all(
                link.state == LinkState.SHARING for link in self._links.values())

    def explain(self, publishers: frozenset[bytes]) -> str:
        """Return why a publisher does not share its frames with this process, or ''."""
        return self._services.explain(publishers)

    def receive(self, info: MessageInfo, deliver: Callable[[], None]) -> None:
        """
        Pass on a message of the image topic, unless its frame is shared.

        :param info: metadata of the message.
        :param deliver: passes the message on.
        """
        with self.lock:
            publisher, number = bytes(info.publisher), info.number
            link = self._links.get(publisher)
            if link is not None and link.state == LinkState.SHARING:
                return
            if link is not None and link.state == LinkState.LEAVING:
                first = max(number, self._passed[publisher] + 1)  # of those that are passed on
                is_followed = self._drain(link, first)
                self._close(publisher)
                self._losses.resume(
                    publisher, first - 1 if is_followed else self._passed[publisher])
                self._report_change()
            if number and number <= self._shared.get(publisher, 0):
                return
            deliver()
            self._passed[publisher] = max(number, self._passed.get(publisher, 0))
            if link is not None and link.state == LinkState.JOINING:
                self._process(link)

    def close(self, may_continue: Callable[[], bool]) -> int:
        """
        Pass on the frames that wait.

        :param may_continue: returns whether to pass on another frame.
        :returns: number of frames that were not passed on.
        """
        unprocessed = 0
        with self.lock:
            for link in self._links.values():
                for frame in self._frames(link):
                    if self._is_new(link, frame):
                        if unprocessed or not may_continue():
                            unprocessed += 1
                        else:
                            self._pass_on(link, frame)
        return unprocessed

    def destroy(self) -> None:
        """Unsubscribe, and end the threads."""
        self._node.destroy_subscription(self._subscription)
        with self.lock:
            links = [*self._links.values()]
            for link in links:
                self._close(link.publisher)
        for link in links:
            link.join()
        self._node.destroy_guard_condition(self._guard)

    # Announcements

    def _read_announcement(self, message: String) -> None:
        with self.lock:
            self._services.add(message.data)
        self._on_change()

    def _open(self, publisher: bytes) -> bool:
        """Open the frames of a publisher and return whether that was possible."""
        service = self._services.of(publisher)
        try:
            reader = process_memory().open_reader(service, self._depth, self._max_views)
        except SharedMemoryError as err:
            self._services.remove(publisher, service, err)
            return False
        link = self._links[publisher] = SharedLink(publisher, service, reader)
        link.start(self._notice, self._fail)
        return True

    def _leave(self, link: SharedLink) -> None:
        if link.state == LinkState.JOINING:
            self._close(link.publisher)
        link.state = LinkState.LEAVING

    def _close(self, publisher: bytes) -> None:
        self._links.pop(publisher).close()

    # Frames

    def _notice(self, link: SharedLink) -> None:
        """Pass on frames, in the thread of their link or in the executor."""
        if self._in_thread:
            with self.lock:
                self._process(link)
        if not self._in_thread or link.is_held:
            self._guard.trigger()

    def _wake(self) -> None:
        """Pass on frames and report changes, in the executor."""
        with self.lock:
            for link in [*self._links.values()]:
                is_overdue = link.is_overdue
                if is_overdue:
                    self._receive_messages()
                if is_overdue or not self._in_thread:
                    self._process(link, is_overdue)
            has_changed, self._has_changed = self._has_changed, False
        if has_changed:
            self._on_change()

    def _process(self, link: SharedLink, is_overdue: bool = False) -> None:
        """
        Pass on the frames of a link, unless messages of the image topic come before them.

        :param is_overdue: whether messages that are missing before the first frame are lost.
        """
        for frame in self._frames(link):
            if not self._is_new(link, frame):
                # The next frame follows the last message.
                if frame.header.message == self._passed.get(link.publisher):
                    self._join(link)
                continue
            if (link.state == LinkState.JOINING and not is_overdue
                    and _missing_messages(frame, self._passed.get(link.publisher, 0))):
                link.hold(frame)
                return
            self._pass_on(link, frame)

    def _frames(self, link: SharedLink) -> Iterator[SharedFrame]:
        """Yield the frames that wait, until the memory cannot be read."""
        try:
            yield from link.frames(self._on_broken)
        except SharedMemoryError as err:
            self._fail(link, err)

    def _fail(self, link: SharedLink, err: SharedMemoryError) -> None:
        with self.lock:
            self._services.remove(link.publisher, link.service, err)
            if not link.is_closed:
                self._leave(link)
            self._report_change()

    def _report_change(self) -> None:
        """Have ``on_change`` called in the executor."""
        self._has_changed = True
        self._guard.trigger()

    def _is_new(self, link: SharedLink, frame: SharedFrame) -> bool:
        """Return whether the frame was not passed on as a message of the image topic."""
        is_new = not frame.header.is_message or (
            frame.header.message > self._passed.get(link.publisher, 0))
        if not is_new:
            link.number = frame.header.number
        return is_new

    def _join(self, link: SharedLink) -> None:
        if link.state == LinkState.JOINING:
            link.state = LinkState.SHARING
            self._report_change()

    def _pass_on(self, link: SharedLink, frame: SharedFrame) -> None:
        header = frame.header
        if link.state == LinkState.JOINING:
            passed = self._passed.get(link.publisher, header.message)
            self._losses.count += _missing_messages(frame, passed)
            self._join(link)
        elif header.number > link.number + 1:
            self._losses.count += header.number - link.number - 1
        link.number = header.number
        self._passed[link.publisher] = self._shared[link.publisher] = header.message
        self._on_frame(WireImage(
            header=WireHeader(header.sec, header.nanosec, frame.frame_id), height=header.height,
            width=header.width, encoding=frame.encoding, is_bigendian=bool(header.is_bigendian),
            step=header.step, data=frame.data), time.time_ns())

    def _drain(self, link: SharedLink, until: int = 0) -> bool:
        """
        Pass on the waiting frames, or those before a message of the image topic.

        :returns: whether a waiting frame follows, so that all frames before it are counted.
        """
        for frame in self._frames(link):
            if not self._is_new(link, frame):
                continue
            header = frame.header
            if until and header.message >= until:
                # Frames from that message on arrive by the image topic.
                self._losses.count += max(
                    0, header.number - link.number - 1 - (header.message - until))
                return True
            self._pass_on(link, frame)
        return False


def _missing_messages(frame: SharedFrame, passed: int) -> int:
    """Return the number of messages of the image topic between the last one and a frame."""
    header = frame.header
    return max(0, header.message - 1 - passed) if header.is_message else 0
