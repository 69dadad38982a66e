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

"""Loaned frames: pixels, memory that is kept or given back, limits, and functions that fill."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from threading import Event, Semaphore, Thread
from typing import Any

from conftest import executor_of, spin_until
import cv2
import numpy as np
from opencv_tools.frames import Frame, FrameNode, FramePublisher, FrameSubscriber
from opencv_tools.frames.loan import LoanedFrame
from opencv_tools.frames.node import ImageFunction
from opencv_tools.image.errors import EncodingError, LayoutError
from opencv_tools.topics.executor import FrameExecutor
from opencv_tools.transport.shared_frames import publisher as shared_publisher
from opencv_tools.transport.shared_frames.memory import FrameMemory
from opencv_tools.transport.shared_frames.pages import SharedMemoryError
from opencv_tools.transport.shared_frames.writer import MAX_LOANS
from opencv_tools.transport.zero_copy import publish_image
import pytest
from rclpy.node import Node
from sharing import picture
from std_msgs.msg import Header
from waiting import LONGEST_SECONDS, wait_until

pytest.importorskip('iceoryx2')

ENCODINGS = ('mono8', 'bgr8', 'bgra8', 'mono16', 'rgb16', '32FC1', '64FC2', 'bayer_gbrg8', 'yuyv',
             'nv12', 'nv24')


class Camera:
    """A publisher of loaned frames and its only subscriber."""

    def __init__(self, node: Node, transport: str = 'shm') -> None:
        self.node = node
        self.frames: list[Frame] = []
        self.publisher = FramePublisher(node, 'camera/image')
        self.subscriber = FrameSubscriber(
            node, 'camera/image', self.frames.append, encoding='', every=True, depth=16,
            transport=transport)
        spin_until(node, lambda: self.publisher.has_subscribers)

    def loan(self, height: int = 4, width: int = 6, encoding: str = 'mono8',
             **options: Any) -> LoanedFrame:
        return self.publisher.loan(height, width, encoding, **options)

    def send(self, value: int) -> bool:
        """Publish a loaned frame of one value, and return whether its memory was shared."""
        with self.loan() as loan:
            loan.image[:] = value
            return is_shared(loan)

    def share(self) -> None:
        """Publish until frames are read where they were filled."""
        spin_until(self.node, lambda: self.send(0) and bool(self.frames)
                   and self.subscriber._subscription.is_shared)
        self.send(255)
        spin_until(self.node, lambda: self.frames[-1].raw[0, 0] == 255)
        self.frames.clear()

    def values(self, count: int) -> list[int]:
        """Wait for frames of one value each."""
        spin_until(self.node, lambda: len(self.frames) >= count)
        assert all((frame.raw == frame.raw.flat[0]).all() for frame in self.frames)
        return [int(frame.raw.flat[0]) for frame in self.frames]

    def destroy(self) -> None:
        self.subscriber.destroy()
        self.publisher.destroy()


def is_shared(loan: LoanedFrame) -> bool:
    return loan._slot is not None


@pytest.fixture
def camera(node: Node) -> Iterator[Camera]:
    """Create a camera whose frames are shared."""
    camera = Camera(node)
    camera.share()
    yield camera
    camera.destroy()


@pytest.mark.parametrize('transport', ['shm', 'raw', 'compressed'])
def test_pixels_of_each_way(node: Node, transport: str) -> None:
    camera = Camera(node, transport)
    if transport == 'shm':
        camera.share()
    encodings = ('mono8', 'mono16') if transport == 'compressed' else ENCODINGS
    for number, encoding in enumerate(encodings):
        pixels = picture(number, encoding, 4, 6)
        header = Header(frame_id='lens')
        header.stamp.sec = number
        spin_until(node, lambda: camera.publisher.has_subscribers)
        with camera.loan(4, 6, encoding, source=header) as loan:
            assert loan.image.shape == pixels.shape
            assert loan.image.dtype == pixels.dtype
            np.copyto(loan.image, pixels)
            assert is_shared(loan) == (transport == 'shm')
        spin_until(node, lambda: len(camera.frames) > number)  # noqa: B023
        frame = camera.frames[-1]
        assert frame.raw.tobytes() == pixels.tobytes() or transport == 'compressed'
        assert frame.raw.shape == pixels.shape
        assert (frame.raw_encoding, frame.stamp.sec, frame.frame_id) == (encoding, number, 'lens')
    if transport == 'compressed':  # PNG
        assert np.array_equal(camera.frames[1].raw, picture(1, 'mono16', 4, 6))
    camera.destroy()


def test_nothing_is_published_after_an_exception(camera: Camera) -> None:
    for number in range(5 * MAX_LOANS):
        with pytest.raises(KeyError), camera.loan() as loan:
            loan.image[:] = number
            assert is_shared(loan)
            raise KeyError
    assert camera.send(77)
    assert camera.values(1) == [77]


def test_frame_that_is_given_back(camera: Camera) -> None:
    with camera.loan() as loan:
        loan.image[:] = 1
        loan.give_back()
        with pytest.raises(RuntimeError, match='inside its with block only'):
            assert loan.image
    assert camera.send(2)
    assert camera.values(1) == [2]


def test_image_outside_of_its_block(camera: Camera) -> None:
    loan = camera.loan()
    with pytest.raises(RuntimeError, match='inside its with block only'):
        assert loan.image
    with pytest.raises(RuntimeError, match='inside its with block only'):
        loan.give_back()
    with loan:
        loan.image[:] = 3
    with pytest.raises(RuntimeError, match='inside its with block only'):
        loan.image[:] = 4
    with pytest.raises(RuntimeError, match='inside its with block only'):
        loan.image = np.zeros((4, 6), np.uint8)
    with pytest.raises(RuntimeError, match='is for one with block'), loan:
        pass
    assert camera.send(5)
    assert camera.values(2) == [3, 5]


def test_sizes_of_numpy(camera: Camera) -> None:
    with camera.loan(*(np.array([8, 10]) // 2)) as loan:
        assert loan.image.shape == (4, 5)


@pytest.mark.parametrize(('size', 'is_checked'), [((8, 8), True), ((8, 7), False)])
def test_image_without_a_write(
        camera: Camera, size: tuple[int, int], is_checked: bool,
        capfd: pytest.CaptureFixture[str]) -> None:
    picture = np.zeros((20, 20), np.uint8)
    with camera.loan(*size) as loan:
        cv2.flip(picture, 1, dst=loan.image)  # has another size
    for corner in ((0, 0), (7, 4)):
        with camera.loan(*size) as loan:
            loan.image[corner] ^= 1  # a lent image has any content
    camera.send(9)
    spin_until(camera.node, lambda: camera.frames and camera.frames[-1].raw.shape == (4, 6))
    assert len(camera.frames) == (3 if is_checked else 4)
    assert ('nothing was written to its image' in capfd.readouterr().err) == is_checked


def test_assigned_image_is_copied(camera: Camera) -> None:
    with camera.loan() as loan:
        loan.image = np.full((4, 6), 8, np.uint8)
        loan.image += 1
        with pytest.raises(ValueError, match='broadcast'):
            loan.image = np.zeros((2, 6), np.uint8)
    assert camera.values(1) == [9]


KEEPERS: tuple[Callable[[np.ndarray], Any], ...] = (
    lambda image: image, lambda image: image[1:, ::2], lambda image: image.reshape(-1).data,
    lambda image: [iter(image)])


@pytest.mark.parametrize('keep', KEEPERS, ids=['image', 'view', 'memory', 'iterator'])
def test_kept_array_is_not_shared(
        camera: Camera, keep: Callable[[np.ndarray], Any], capfd: pytest.CaptureFixture[str],
) -> None:
    kept = []
    for value in range(1, 3 * MAX_LOANS):
        with camera.loan() as loan:
            loan.image[:] = value
            kept.append(keep(loan.image))
            assert is_shared(loan) == (value <= MAX_LOANS)
    for memory in kept[:-1]:
        if isinstance(memory, np.ndarray):
            memory[:] = 200
    assert camera.values(3 * MAX_LOANS - 1) == [*range(1, 3 * MAX_LOANS)]
    assert capfd.readouterr().err.count('a loaned frame is copied') == 1
    kept.clear()
    del memory
    assert camera.send(99)
    assert camera.values(3 * MAX_LOANS)[-1] == 99


def test_array_that_outlives_its_publisher(camera: Camera) -> None:
    with camera.loan(1080, 1920) as loan:
        image = loan.image
        image[:] = 6
    camera.destroy()
    image[:1000] = 7
    assert image.sum() == 1920 * (1000 * 7 + 80 * 6)


def test_loans_that_do_not_end(camera: Camera) -> None:
    left = [camera.loan().__enter__() for _ in range(MAX_LOANS + 2)]
    assert [is_shared(loan) for loan in left] == [True] * MAX_LOANS + [False] * 2
    assert not camera.send(1)
    camera.publisher.publish(np.full((4, 6), 2, np.uint8))
    assert camera.values(2) == [1, 2]
    left.clear()
    assert camera.send(3)


def test_loans_at_once_end_in_any_order(camera: Camera) -> None:
    first, second = camera.loan(), camera.loan(8, 9)
    with first:
        first.image[:] = 1
        second.__enter__()
        second.image[:] = 2
    second.__exit__(None, None, None)
    assert camera.values(2) == [1, 2]


def test_larger_frames_while_a_loan_is_filled(camera: Camera) -> None:
    with camera.loan() as loan:
        loan.image[:] = 10
        for number in range(1, 4):
            with camera.loan(number * 300, 400) as larger:
                larger.image[:] = number
                assert is_shared(larger)
    assert camera.values(4) == [1, 2, 3, 10]


def test_subscriber_that_leaves_while_a_loan_is_filled(node: Node, camera: Camera) -> None:
    raw: list[Frame] = []
    with camera.loan() as loan:
        loan.image[:] = 4
        camera.subscriber.destroy()
        subscriber = FrameSubscriber(node, 'camera/image', raw.append, transport='raw')
        spin_until(node, lambda: camera.publisher._topics.images.get_subscription_count() == 1)
    spin_until(node, lambda: bool(raw))
    assert (raw[0].raw == 4).all()
    subscriber.destroy()


def test_service_that_is_replaced_while_a_loan_is_filled(node: Node) -> None:
    camera = Camera(node, 'auto')
    camera.share()
    shared = camera.publisher._topics.shared
    with camera.loan() as loan:
        loan.image[:] = 4
        old = shared._writer
        shared._withdraw(SharedMemoryError('withdrawn by the test'))

        def leave() -> bool:
            camera.frames.clear()  # a frame keeps its reader
            return not camera.send(5) and not old.readers

        spin_until(camera.node, leave)
        shared._writer = None
        shared._next_check = 0.0
        camera.share()
    camera.frames.clear()
    spin_until(camera.node, lambda: bool(camera.frames) and camera.frames[-1].raw[0, 0] == 4)
    camera.destroy()


def test_memory_without_room(camera: Camera, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise SharedMemoryError('/dev/shm has 0 bytes free')

    published = camera.publisher._topics.shared.frames
    with monkeypatch.context() as patch:
        patch.setattr(FrameMemory, 'check_room', refuse)
        with camera.loan(1080, 1920, 'bgr8') as loan:
            assert not is_shared(loan)
            loan.image[:] = 1
    assert camera.publisher._topics.shared.frames == published + 1


@pytest.mark.parametrize(('arguments', 'error', 'text'), [
    ((0, 6, 'mono8'), LayoutError, 'height is 0: give a whole number of pixels, at least 1'),
    ((4, -1, 'mono8'), LayoutError, 'width is -1'),
    ((4.0, 6, 'mono8'), LayoutError, 'height is 4.0'),
    ((4, True, 'mono8'), LayoutError, 'width is True'),
    ((4, 6, 'bgr9'), EncodingError, 'bgr9'),
    ((4, 6, None), EncodingError, "encoding is None: give a name, such as 'bgr8'"),
    ((5, 6, 'nv12'), LayoutError, 'nv12 has no image of 6x5: give an even width and height'),
    ((65536, 65536, 'mono8'), LayoutError, '4294967296 bytes: a message has at most 4294967295')])
def test_refused_sizes(
        node: Node, arguments: tuple[Any, ...], error: type[Exception], text: str) -> None:
    publisher = FramePublisher(node, 'camera/image')
    with pytest.raises(error) as raised:
        publisher.loan(*arguments)
    assert text in str(raised.value)
    publisher.destroy()


def test_source_that_the_block_sets(camera: Camera) -> None:
    with pytest.raises(TypeError, match="the source of a frame is 'now'"), camera.loan() as loan:
        loan.source = 'now'
    with camera.loan() as loan:
        loan.image[:] = 1
        loan.source = Header(frame_id='set')
    camera.values(1)
    assert camera.frames[0].frame_id == 'set'


# Functions

IMAGE = np.arange(24, dtype=np.uint8).reshape(4, 6)


def fill(image: np.ndarray, out: np.ndarray) -> None:
    np.copyto(out, 255 - image)


def fill_and_return(image: np.ndarray, *, out: np.ndarray) -> np.ndarray:
    return np.subtract(255, image, out=out)


def return_another(image: np.ndarray, out: np.ndarray) -> np.ndarray:
    out[:] = 7
    return cv2.flip(255 - image[:2], -1)


def return_several(image: np.ndarray, out: np.ndarray) -> tuple[float, np.ndarray]:
    return 0.5, fill_and_return(image, out=out)


def keep_nothing(image: np.ndarray, out: None = None) -> np.ndarray:
    assert out is None
    return 255 - image


def fill_by(image: np.ndarray, minuend: int, out: np.ndarray) -> np.ndarray:
    return np.subtract(minuend, image, out=out)


@pytest.mark.parametrize(('function', 'arguments', 'shares', 'expected'), [
    (fill, (), True, 255 - IMAGE), (fill_and_return, (), True, 255 - IMAGE),
    (return_several, (), True, 255 - IMAGE), (fill_by, (255,), True, 255 - IMAGE),
    (partial(fill_by, minuend=255), (), True, 255 - IMAGE),
    (return_another, (), False, cv2.flip(255 - IMAGE[:2], -1)),
    (keep_nothing, (), False, 255 - IMAGE), (np.invert, (), False, 255 - IMAGE),
    (cv2.flip, (1,), False, cv2.flip(IMAGE, 1)), (lambda image: None, (), False, None)],
    ids=['nothing', 'out', 'several', 'arguments', 'partial', 'another', 'default', 'numpy',
         'OpenCV', 'no image'])
def test_function_that_fills(
        node: Node, camera: Camera, function: Callable[..., Any], arguments: tuple[Any, ...],
        shares: bool, expected: np.ndarray | None, monkeypatch: pytest.MonkeyPatch) -> None:
    camera.publisher.publish(IMAGE, encoding='mono8')
    spin_until(node, lambda: bool(camera.frames))
    frame = camera.frames.pop()
    slots = []
    share = camera.publisher._topics.shared.publish
    monkeypatch.setattr(camera.publisher._topics.shared, 'publish', lambda image, **options: (
        slots.append(options['slot']), share(image, **options)))
    ImageFunction(function, arguments).publish(frame, camera.publisher)
    assert [slot is not None for slot in slots] == ([] if expected is None else [shares])
    camera.publisher.publish(np.zeros((1, 1), np.uint8))
    spin_until(node, lambda: camera.frames and camera.frames[-1].raw.shape == (1, 1))
    results = [result.raw for result in camera.frames[:-1]]
    assert len(results) == len(slots) - 1
    if expected is not None:
        assert np.array_equal(results[0], expected)


# Threads

@pytest.mark.parametrize('transport', ['raw', 'compressed'])
def test_loans_of_several_threads(node: Node, camera: Camera, transport: str) -> None:
    other: list[Frame] = []
    on_their_way = Semaphore(5)  # fewer than any queue holds

    def receive(frame: Frame) -> None:
        other.append(frame)
        on_their_way.release()

    subscriber = FrameSubscriber(
        node, 'camera/image', receive, encoding='', every=True, transport=transport)
    subscribers = (camera.publisher._topics.images.get_subscription_count,
                   camera.publisher._topics.compressed.count_subscribers)
    spin_until(node, lambda: any(count() for count in subscribers))
    turns = iter(range(1, 121))

    def publish() -> None:
        for number in turns:
            wait_until(lambda: on_their_way.acquire(blocking=False))
            with camera.loan(120, 160, 'mono16', source=Header(frame_id=str(number))) as loan:
                loan.image[:] = number

    threads = [Thread(target=publish) for _ in range(3)]
    for thread in threads:
        thread.start()
    spin_until(node, lambda: len(other) >= 120)
    for thread in threads:
        thread.join()
    for frame in (*camera.frames, *other):
        assert (frame.raw == int(frame.frame_id)).all()
    assert sorted(int(frame.frame_id) for frame in other) == [*range(1, 121)]
    subscriber.destroy()


def test_memory_is_not_lent_before_its_message_is_published(
        node: Node, camera: Camera, monkeypatch: pytest.MonkeyPatch) -> None:
    raw: list[Frame] = []
    subscriber = FrameSubscriber(node, 'camera/image', raw.append, transport='raw')
    spin_until(node, lambda: camera.publisher._topics.images.get_subscription_count() > 0)
    waited: list[bool] = []

    def publish_late(*arguments: Any) -> None:
        other = Thread(target=camera.publisher._topics.shared.lend, args=(24,))
        other.start()
        other.join(0.2)
        waited.append(other.is_alive())
        publish_image(*arguments)

    monkeypatch.setattr(shared_publisher, 'publish_image', publish_late)
    assert camera.send(3)
    spin_until(node, lambda: bool(raw))
    assert waited == [True]
    subscriber.destroy()


@pytest.mark.parametrize('threaded', [False, True])
@pytest.mark.parametrize('in_callback', [False, True])
def test_node_that_is_destroyed(camera: Camera, threaded: bool, in_callback: bool) -> None:
    """No frame comes after `destroy_node`, also if a callback has called it."""
    node = FrameNode('eyes', context=camera.node.context)
    destroyed, values = Event(), list[int]()
    camera.subscriber.destroy()

    def receive(frame: Frame) -> None:
        values.append(int(frame.raw[0, 0]))
        if in_callback and values[-1] == 3:
            node.destroy_node()
            destroyed.set()

    subscriber = node.receive_frames(
        'camera/image', receive, encoding='', every=True, depth=16, transport='shm',
        threaded=threaded)
    executor = FrameExecutor(context=node.context)
    executor.add_node(node)
    with executor_of(camera.node) as other:
        def spin() -> None:
            executor.spin_once(0.01)
            other.spin_once(0.01)

        wait_until(lambda: camera.send(0) and subscriber._subscription.is_shared,
                   'shared frames', spin)
        for value in (1, 2, 3):
            camera.send(value)
            wait_until(partial(values.__contains__, value), 'the frame', spin)
        if in_callback:
            assert destroyed.wait(LONGEST_SECONDS)
        else:
            node.destroy_node()
        for value in (4, 5, 6):
            camera.send(value)
            spin()
        wait_until(lambda: not camera.publisher.has_subscribers, 'its end', spin)
        assert values[-1] == 3
    executor.shutdown()
