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

"""What the queue of a subscription keeps, pairs, skips and counts."""

from __future__ import annotations

from queue import Queue
from threading import Thread

from builtin_interfaces.msg import Time
from opencv_tools.image.cdr import WireHeader, WireImage
from opencv_tools.image.errors import CdrError
from opencv_tools.topics.order import Position, Way
from opencv_tools.topics.queue import FrameQueue, ReceivedMessage
from opencv_tools.video.messages import FFMPEG_PACKET, WireVideo
import pytest
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from waiting import item_of, join, LONGEST_SECONDS, wait_until

PUBLISHER, OTHER_PUBLISHER = bytes(range(16)), bytes(16)


def frame(number: int) -> ReceivedMessage:
    image = WireImage(header=WireHeader(number, 500, 'camera'), height=1, width=1,
                      encoding='mono8', is_bigendian=False, step=1, data=b'\0')
    return ReceivedMessage(image, number, number, number)


def info(number: int) -> CameraInfo:
    return CameraInfo(header=Header(stamp=Time(sec=number, nanosec=500)), width=number)


def put(queue: FrameQueue, *numbers: int, **options: bool) -> None:
    for number in numbers:
        queue.put(frame(number), PUBLISHER, Position(number), **options)


def pop_all(queue: FrameQueue) -> list[int]:
    """Return the numbers of all frames, after a check of their calibrations."""
    numbers = []
    while popped := queue.pop():
        assert isinstance(popped, ReceivedMessage)
        assert popped.camera_info is None or popped.camera_info.width == popped.number
        numbers.append(popped.number)
    return numbers


def test_message_of_which_nothing_else_is_known() -> None:
    message = ReceivedMessage(frame(7).message, 8)
    assert (message.publish_ns, message.number, message.camera_info, message.publisher) == (
        0, 0, None, b'')
    assert (message.stamp_ns, message.image) == (7_000_000_500, message.message)


def test_image_of_a_message_of_video() -> None:
    video = WireVideo(type_name=FFMPEG_PACKET, header=WireHeader(1, 2, 'camera'),
                      encoding='h264', data=b'', serialized=b'')
    with pytest.raises(TypeError, match=(
            r'^the message is video, which this subscription does not decode$')):
        _ = ReceivedMessage(video, 8).image


@pytest.mark.parametrize(('capacity', 'held', 'is_full'), [
    (1, 0, False), (1, 1, False), (2, 0, False), (2, 1, False), (2, 2, True), (2, 3, True)])
def test_room_of_the_queue(capacity: int, held: int, is_full: bool) -> None:
    queue = FrameQueue(capacity)
    put(queue, *range(1, held + 1), keeps_all=True)
    assert (queue.is_full, queue.keeps_newest) == (is_full, capacity == 1)
    assert queue.wait_for_room(0.0) is not is_full


@pytest.mark.parametrize(('capacity', 'kept'), [(1, [5]), (3, [3, 4, 5]), (9, [1, 2, 3, 4, 5])])
def test_frames_that_find_the_queue_full(capacity: int, kept: list[int]) -> None:
    queue = FrameQueue(capacity)
    put(queue, 1, 2, 3, 4, 5)
    assert (pop_all(queue), queue.skipped, queue.count) == (kept, 5 - len(kept), 5)


def test_frames_that_may_exceed_the_capacity() -> None:
    queue = FrameQueue(2)
    put(queue, 1, 2, 3, 4, keeps_all=True)
    put(queue, 5)  # replaces one
    assert (pop_all(queue), queue.skipped) == ([2, 3, 4, 5], 1)


@pytest.mark.parametrize('end', ['pop', 'close'])
def test_thread_that_waits_for_room(end: str) -> None:
    queue = FrameQueue(2)
    assert queue.wait_for_room(0.0)
    put(queue, 1, 2)
    assert not queue.wait_for_room(0.01)
    found: list[bool] = []
    waiting = Thread(target=lambda: found.append(queue.wait_for_room(10 * LONGEST_SECONDS)))
    waiting.start()
    getattr(queue, end)()
    join(waiting)
    assert found == [True]


def test_last_frames_that_the_next_publisher_replaces() -> None:
    queue = FrameQueue(2)
    put(queue, 1, 2, 5)
    for number in (1, 2):
        queue.put(frame(number), OTHER_PUBLISHER, Position(number))
    assert (pop_all(queue), queue.skipped, queue.order.count) == ([1, 2], 3, 2)
    assert queue.skipped + queue.order.count == 5  # all frames of the first publisher


def test_repeated_frame_is_in_no_count() -> None:
    queue = FrameQueue(9)
    put(queue, 1, 2, 2, 1, 3)
    assert (pop_all(queue), queue.skipped, queue.count, queue.order.count) == ([1, 2, 3], 0, 3, 0)


def test_message_whose_number_jumps_is_one_error() -> None:
    queue = FrameQueue(9)
    put(queue, 1, 2**40, 2)
    frames = [queue.pop() for _ in range(3)]
    assert [type(found) for found in frames] == [ReceivedMessage, CdrError, ReceivedMessage]
    assert isinstance(frames[1], CdrError)
    assert str(2**40) in str(frames[1])
    assert frames[1].__traceback__ is None  # it would keep the pixels
    assert (queue.order.count, queue.skipped) == (0, 0)


def test_discarded_message_explains_the_next_gap() -> None:
    queue = FrameQueue(9)
    put(queue, 1)
    queue.put(CdrError('broken'), b'', None)
    put(queue, 3, 5)
    assert (queue.order.count, queue.count) == (1, 4)


def test_video_before_its_key_frame() -> None:
    queue = FrameQueue(9)
    for number in (1, 2, 2):  # the last one is repeated
        queue.leave_out(PUBLISHER, Position(number))
    assert (queue.left_out, queue.waits_for_key_frame) == (2, True)
    assert (queue.count, queue.has_frames, queue.skipped) == (0, False, 0)
    put(queue, 3)
    assert (queue.left_out, queue.waits_for_key_frame, pop_all(queue)) == (2, False, [3])
    queue.leave_out(b'', None)  # has no number, thus it may be 4
    put(queue, 5)
    assert (queue.left_out, queue.order.count, queue.count) == (3, 0, 2)


def test_video_whose_number_jumps_is_in_no_count() -> None:
    queue = FrameQueue(9)
    put(queue, 1)
    queue.leave_out(PUBLISHER, Position(2**40))
    assert (queue.left_out, queue.waits_for_key_frame, queue.order.count) == (0, False, 0)


def test_way_of_the_publisher_is_returned() -> None:
    queue = FrameQueue(9)
    queue.order.change(PUBLISHER, Way.JOINING)
    assert queue.put(frame(1), PUBLISHER, Position(1)) is Way.JOINING
    assert queue.put(frame(2), PUBLISHER, Position(2, 2)) is Way.SHARED
    assert queue.put(frame(2), PUBLISHER, Position(2)) is Way.SHARED  # not accepted
    assert pop_all(queue) == [1, 2]


def test_frames_before_their_calibrations() -> None:
    queue = FrameQueue(9, with_info=True)
    for number in (1, 2, 3):
        put(queue, number)
        assert queue.has_unpaired and not queue.has_frames
        queue.put_info(info(number))
        assert not queue.has_unpaired
        assert pop_all(queue) == [number]
    assert (queue.skipped, queue.complete) == (0, 3)


def test_frames_after_their_calibrations() -> None:
    queue = FrameQueue(9, with_info=True)
    for number in (1, 2, 3):
        queue.put_info(info(number))
        put(queue, number)
        assert queue.has_frames and not queue.has_unpaired
        assert pop_all(queue) == [number]
    assert (queue.skipped, queue.complete) == (0, 3)


def test_frames_without_a_calibration_are_skipped() -> None:
    queue = FrameQueue(9, with_info=True)
    put(queue, 1, 2, 3, 4)
    queue.put_info(info(3))
    assert (pop_all(queue), queue.skipped, queue.has_unpaired) == ([3], 2, True)
    queue.put_info(info(4))
    assert (pop_all(queue), queue.skipped, queue.complete) == ([4], 2, 2)


@pytest.mark.parametrize('with_info', [False, True])
def test_calibration_that_is_not_requested(with_info: bool) -> None:
    queue = FrameQueue(9, with_info=with_info)
    queue.put_info(info(7))
    put(queue, 1)
    assert pop_all(queue) == ([] if with_info else [1])


def test_calibrations_that_complete_more_than_fit() -> None:
    queue = FrameQueue(1, with_info=True)
    put(queue, 1)
    queue.put_info(info(1))
    put(queue, 2)
    queue.put_info(info(2))
    assert (pop_all(queue), queue.skipped) == ([2], 1)


def test_calibrations_that_never_find_their_frame() -> None:
    queue = FrameQueue(1, with_info=True)
    for number in range(1, 32):  # one more than are kept
        queue.put_info(info(number))
    put(queue, 1)
    assert pop_all(queue) == []
    put(queue, 2)
    assert (pop_all(queue), queue.skipped) == ([2], 1)


def test_images_that_wait_for_a_calibration_are_bounded() -> None:
    queue = FrameQueue(3, with_info=True)
    put(queue, *range(1, 8))  # two more than are kept
    assert queue.skipped == 2
    queue.put_info(info(3))
    assert pop_all(queue) == [3]


def test_error_waits_for_no_calibration() -> None:
    queue = FrameQueue(9, with_info=True)
    queue.put(CdrError('broken'), PUBLISHER, Position(1))
    assert isinstance(queue.pop(), CdrError)


def test_closed_queue_skips_what_waits() -> None:
    queue = FrameQueue(9, with_info=True)
    queue.put_info(info(1))
    put(queue, 1, 2, 3)
    queue.close()
    assert (queue.wait(), queue.pop(), queue.skipped) == (None, None, 3)


@pytest.mark.parametrize('with_info', [False, True])
def test_thread_that_waits(with_info: bool) -> None:
    queue = FrameQueue(9, with_info=with_info)
    taken: Queue[object] = Queue()

    def take() -> None:
        while found := queue.wait():
            taken.put(found)
        taken.put(None)

    thread = Thread(target=take, daemon=True)
    thread.start()
    for number in (1, 2, 3):
        put(queue, number)
        if with_info:
            wait_until(lambda: queue.lock._waiters, 'the thread, which waits for the calibration')
            queue.put_info(info(number))
        found = item_of(taken)
        assert isinstance(found, ReceivedMessage)
        assert (found.number, found.camera_info is not None) == (number, with_info)
    queue.close()
    assert item_of(taken) is None
    join(thread)
