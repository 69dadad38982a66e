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

"""Publishing and taking of messages through rcl, without rclpy's copies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import ctypes
from dataclasses import replace
from pathlib import Path
import time
from typing import Any

from conftest import spin_until
import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.cdr import cdr_to_image, image_to_cdr, WireHeader, WireImage
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.errors import CdrError
from opencv_tools.image.layout import array_to_wire
from opencv_tools.transport import rcl_structures, zero_copy
from opencv_tools.transport.rcl_structures import MessageInfo
from opencv_tools.transport.zero_copy import (
    publish_image, take_image, take_serialized, TakenImage,
)
import pytest
import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image
from waiting import wait_until

MB = 1 << 20
PIXEL = WireImage(header=WireHeader(1, 2, 'camera'), height=1, width=1, encoding='mono8',
                  is_bigendian=False, step=1, data=b'\x07')


def large_image(value: int) -> WireImage:
    """Return an image of 6 MB."""
    return WireImage(header=WireHeader(value, 0, ''), height=1024, width=2048, encoding='bgr8',
                     is_bigendian=False, step=3 * 2048,
                     data=np.full(6 * MB, value % 256, np.uint8))


IMAGES = [
    PIXEL, large_image(200),
    replace(PIXEL, header=WireHeader(-1, 999_999_999, 'Kamera für 深度'), is_bigendian=True),
    replace(PIXEL, header=WireHeader(1, 2, ''), encoding=''),
    replace(PIXEL, header=WireHeader(1, 2, 'a' * 10**6)),
    replace(PIXEL, step=2**32 - 1, data=b'')]


@pytest.fixture
def publisher(node: Node) -> Publisher:
    return node.create_publisher(Image, 'images', 10)


@pytest.fixture
def subscription(node: Node, publisher: Publisher) -> Subscription:
    """Return a subscription that has met the publisher, and that no executor takes from."""
    made = node.create_subscription(Image, 'images', lambda _: None, 10, raw=True)
    spin_until(node, lambda: publisher.get_subscription_count() == 1)
    return made


def take(subscription: Subscription) -> tuple[NDArray[np.uint8], MessageInfo]:
    """Take a message, which may still be in transit."""
    return wait_until(lambda: take_serialized(subscription.handle), 'a message')


def take_next_image(subscription: Subscription) -> TakenImage:
    """Take an image, which may still be in transit."""
    taken: list[TakenImage] = []

    def has_image() -> bool:
        taken.append(take_image(subscription.handle))
        return taken[-1].image is not None

    wait_until(has_image, 'a message')
    return taken[-1]


def read_image(subscription: Subscription) -> WireImage:
    """Take a serialized image and read it."""
    return cdr_to_image(take(subscription)[0])


def read_rcl_image(subscription: Subscription) -> WireImage:
    """Take an image that the middleware has read."""
    image = take_next_image(subscription).image
    assert image
    return image


READERS = pytest.mark.parametrize('read', [read_image, read_rcl_image])


def resident_bytes() -> int:
    """Return the resident memory of this process in bytes."""
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * 4096


@pytest.mark.parametrize('image', IMAGES)
def test_images_at_an_rclpy_subscriber(
        node: Node, publisher: Publisher, image: WireImage) -> None:
    received: list[Image] = []
    node.create_subscription(Image, 'images', received.append, 10)
    spin_until(node, lambda: publisher.get_subscription_count() == 1)
    publish_image(publisher.handle, image)
    spin_until(node, lambda: len(received) == 1)
    expected = Image(height=image.height, width=image.width, encoding=image.encoding,
                     is_bigendian=int(image.is_bigendian), step=image.step,
                     data=bytes(image.data))
    header = expected.header
    header.stamp.sec, header.stamp.nanosec = image.header.sec, image.header.nanosec
    header.frame_id = image.header.frame_id
    assert received == [expected]


@READERS
def test_taken_images(
        publisher: Publisher, subscription: Subscription,
        read: Callable[[Subscription], WireImage]) -> None:
    for image in IMAGES:
        publish_image(publisher.handle, image)
    for image in IMAGES:
        taken = read(subscription)
        assert bytes(taken.data) == bytes(image.data)
        assert replace(taken, data=b'') == replace(image, data=b'')


def test_taken_text_that_is_not_unicode(
        publisher: Publisher, subscription: Subscription) -> None:
    publisher.publish(image_to_cdr(PIXEL).replace(b'mono8', b'mono\xff'))
    assert read_rcl_image(subscription).encoding == 'mono\ufffd'


def test_array_that_is_not_contiguous(
        publisher: Publisher, subscription: Subscription) -> None:
    whole = np.arange(60 * 40 * 3, dtype=np.uint8).reshape(60, 40, 3)
    array = whole[::2, 5:25, ::-1]
    publish_image(publisher.handle, array_to_wire(array, find_encoding('bgr8')))
    message = cdr_to_image(take(subscription)[0])
    assert (message.height, message.width, message.step) == (30, 20, 60)
    assert bytes(message.data) == array.tobytes()


@pytest.mark.parametrize('fields', [
    {'header': WireHeader(1, 2, 'a\0b')}, {'encoding': 'a\0b'}], ids=['frame_id', 'encoding'])
def test_refused_nul_character(
        publisher: Publisher, subscription: Subscription, fields: dict[str, Any]) -> None:
    with pytest.raises(CdrError, match='has a NUL'):
        publish_image(publisher.handle, replace(PIXEL, **fields))
    publish_image(publisher.handle, PIXEL)
    assert cdr_to_image(take(subscription)[0]) == PIXEL
    assert take_serialized(subscription.handle) is None


def test_destroyed_publisher_and_subscription(
        node: Node, publisher: Publisher, subscription: Subscription) -> None:
    publisher_handle, subscription_handle = publisher.handle, subscription.handle
    node.destroy_publisher(publisher)
    node.destroy_subscription(subscription)
    with pytest.raises(RuntimeError, match=r'\w+ \w+'):
        publish_image(publisher_handle, PIXEL)
    for take_message in (take_serialized, take_image):
        with pytest.raises(RuntimeError, match=r'\w+ \w+'):
            take_message(subscription_handle)


def destroy_meanwhile(
        monkeypatch: pytest.MonkeyPatch, name: str, destroy: Callable[[], object]) -> None:
    """Call ``destroy`` immediately before a function of rcl."""
    function = getattr(zero_copy._rcl, name)

    def _call(*args: object) -> int:
        destroy()
        return function(*args)

    monkeypatch.setattr(zero_copy._rcl, name, _call)


def test_publisher_destroyed_during_a_call(
        node: Node, publisher: Publisher, subscription: Subscription,
        monkeypatch: pytest.MonkeyPatch) -> None:
    destroy_meanwhile(monkeypatch, 'rcl_publish', lambda: node.destroy_publisher(publisher))
    publish_image(publisher.handle, PIXEL)
    assert cdr_to_image(take(subscription)[0]) == PIXEL
    with pytest.raises(RuntimeError, match=r'\w+ \w+'):
        publish_image(publisher.handle, PIXEL)


@pytest.mark.parametrize(('function', 'read'), [
    ('rcl_take', read_rcl_image), ('rcl_take_serialized_message', read_image)])
def test_subscription_destroyed_during_a_call(
        node: Node, publisher: Publisher, subscription: Subscription,
        monkeypatch: pytest.MonkeyPatch, function: str,
        read: Callable[[Subscription], WireImage]) -> None:
    publish_image(publisher.handle, PIXEL)
    wait_until(lambda: publisher.wait_for_all_acked(Duration()))
    destroy_meanwhile(monkeypatch, function, lambda: node.destroy_subscription(subscription))
    assert read(subscription) == PIXEL
    with pytest.raises(RuntimeError, match=r'\w+ \w+'):
        read(subscription)


def test_publishing_after_shutdown(domain: int) -> None:
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node('short', context=context)
    publisher = node.create_publisher(Image, 'images', 10)
    rclpy.shutdown(context=context)
    for _ in range(2):
        with pytest.raises(RuntimeError, match=r'\w+ \w+'):
            publish_image(publisher.handle, PIXEL)
    node.destroy_node()


def test_taking_without_a_message(subscription: Subscription) -> None:
    assert [take_serialized(subscription.handle) for _ in range(3)] == [None] * 3
    taken = [take_image(subscription.handle) for _ in range(3)]
    assert [(image, unreadable) for image, _, unreadable in taken] == [(None, '')] * 3


@pytest.mark.parametrize(('size', 'reason'), [
    (3, 'Fast CDR exception'), (30, 'Fast CDR exception'), (-5, 'its data are cut off')])
def test_unreadable_messages(
        publisher: Publisher, subscription: Subscription, size: int, reason: str) -> None:
    whole = image_to_cdr(replace(PIXEL, data=bytes(100)))
    for _ in range(2):
        publisher.publish(whole[:size])
    wait_until(lambda: publisher.wait_for_all_acked(Duration()))
    image, _, unreadable = take_image(subscription.handle)
    assert image is None
    assert unreadable.startswith(reason)
    assert take_image(subscription.handle).unreadable == ''
    publisher.publish(whole[:size])
    publisher.publish(whole)
    image, info, unreadable = take_next_image(subscription)
    assert (image, info.number) == (cdr_to_image(whole), 4)
    # The middleware does not report data that are cut off before another message.
    assert unreadable.startswith(reason) or size == -5
    assert take_image(subscription.handle).unreadable == ''


def test_metadata_of_messages(
        publisher: Publisher, subscription: Subscription) -> None:
    began = time.time_ns()
    for _ in range(3):
        publish_image(publisher.handle, PIXEL)
    infos = [take(subscription)[1], take_next_image(subscription).info, take(subscription)[1]]
    assert [info.number for info in infos] == [1, 2, 3]
    assert len({bytes(info.publisher) for info in infos}) == 1
    assert all(began <= info.source_timestamp <= info.received_timestamp <= time.time_ns()
               for info in infos)


@pytest.mark.parametrize(('given', 'number'), [(0, 0), (1, 1), (2**64 - 2, 2**64 - 2),
                                               (2**64 - 1, 0)])
def test_sequence_number(given: int, number: int) -> None:
    assert MessageInfo(publication_sequence_number=given).number == number


@READERS
def test_read_only_data_after_the_subscription(
        node: Node, publisher: Publisher, subscription: Subscription,
        read: Callable[[Subscription], WireImage]) -> None:
    images = [large_image(value) for value in range(3)]
    for image in images:
        publish_image(publisher.handle, image)
    messages = [read(subscription) for _ in images]
    node.destroy_subscription(subscription)
    for message, image in zip(messages, images):
        assert message.header.sec == image.header.sec
        assert np.array_equal(np.frombuffer(message.data, np.uint8), image.data)
        assert message.data.readonly
        with pytest.raises(ValueError, match='read-only'):
            np.frombuffer(message.data, np.uint8)[0] = 1


@pytest.mark.quick_cases(1)
@READERS
def test_memory_of_taken_messages(
        publisher: Publisher, subscription: Subscription, tell: Callable[[str], None],
        read: Callable[[Subscription], WireImage]) -> None:
    sizes = []
    frame_id = 'a' * MB
    for value in range(70):
        publish_image(publisher.handle, replace(
            large_image(value), header=WireHeader(value, 0, frame_id)))
        message = read(subscription)
        assert message.header.frame_id == frame_id
        assert message.data[-1] == value % 256
        if value >= 20:
            sizes.append(resident_bytes())
    tell(f'{(sizes[-1] - sizes[0]) / MB:.1f} MB more after 50 images of 7 MB')
    assert sizes[-1] - sizes[0] < 15 * MB


def test_memory_of_unreadable_messages(
        publisher: Publisher, subscription: Subscription) -> None:
    whole = image_to_cdr(replace(PIXEL, header=WireHeader(1, 2, 'a' * MB), data=bytes(100)))
    sizes = []
    for number in range(120):
        publisher.publish(whole[:-5])
        wait_until(lambda: publisher.wait_for_all_acked(Duration()))
        assert take_image(subscription.handle).unreadable
        if number >= 20:
            sizes.append(resident_bytes())
    assert sizes[-1] - sizes[0] < 30 * MB


class OtherImage(ctypes.Structure):
    """An image with an additional field."""

    _fields_ = (*rcl_structures.RclImage._fields_[:4], ('depth', ctypes.c_uint64),
                *rcl_structures.RclImage._fields_[4:])


class LargerImage(rcl_structures.RclImage):
    """An image with an additional last field."""

    _fields_ = (('depth', ctypes.c_uint64),)


class ShortBytes(ctypes.Structure):
    """A sequence without a capacity."""

    _fields_ = rcl_structures.RclBytes._fields_[:2]


class SmallerImage(ctypes.Structure):
    """An image with a shorter last field."""

    _fields_ = (*rcl_structures.RclImage._fields_[:-1], ('data', ShortBytes))


class OtherArray(ctypes.Structure):
    """A serialized message with two fields swapped."""

    _fields_ = tuple(
        rcl_structures.RmwSerializedMessage._fields_[index] for index in (0, 2, 1, 3))


@pytest.fixture
def use_rcl_again() -> Iterator[None]:
    """Select rcl again after a test."""
    yield
    assert zero_copy.use_rcl() == ''


@pytest.mark.parametrize(('name', 'value', 'reason'), [
    *(('_FUNCTIONS', {**zero_copy._FUNCTIONS, library: (f'{function}_gone',)}, f'{function}_gone')
      for library, functions in zero_copy._FUNCTIONS.items() for function in functions),
    *(('_FUNCTIONS', {f'gone_{library}': ()}, f'gone_{library}')
      for library in zero_copy._FUNCTIONS),
    *(('IMAGE_LAYOUTS', (image,), 'sensor_msgs__msg__Image has another layout')
      for image in (OtherImage, LargerImage, SmallerImage, rcl_structures.RclBufferImage)),
    ('RmwSerializedMessage', OtherArray, 'rmw_serialized_message_t has another layout'),
    ('OPENCV_TOOLS_TRANSPORT', 'default', 'OPENCV_TOOLS_TRANSPORT is default')])
def test_fallback_to_rclpy(
        use_rcl_again: None, publisher: Publisher, subscription: Subscription,
        name: str, value: Any, reason: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        if name.startswith('OPENCV_'):
            patch.setenv(name, value)
        else:
            patch.setattr(zero_copy if name == '_FUNCTIONS' else rcl_structures, name, value)
        assert reason in zero_copy.use_rcl()
        images = [large_image(3), replace(
            PIXEL, header=WireHeader(1, 2, 'Kamera für 深度'), is_bigendian=True)]
        for image in images:
            publish_image(publisher.handle, image)
            data, info = take(subscription)
            message = cdr_to_image(data)
            assert bytes(message.data) == bytes(image.data)
            assert replace(message, data=b'') == replace(image, data=b'')
            assert (info.number, info.source_timestamp > 0) == (0, True)
            assert info.received_timestamp >= info.source_timestamp
        assert take_serialized(subscription.handle) is None
        with pytest.raises(CdrError, match='has a NUL'):
            publish_image(publisher.handle, replace(PIXEL, header=WireHeader(1, 2, 'a\0b')))


def test_message_without_a_byte(node: Node, publisher: Publisher,
                                subscription: Subscription) -> None:
    publisher.publish(b'')
    data, _ = take(subscription)
    assert (data.shape, data.dtype) == ((0,), np.uint8)
