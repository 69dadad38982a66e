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

from conftest import DEADLINE, spin_until
import numpy as np
from numpy.typing import NDArray
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.cdr import cdr_to_image, WireHeader, WireImage
from opencv_tools.image.errors import CdrError
from opencv_tools.ros import zero_copy
from opencv_tools.ros.zero_copy import MessageInfo, publish_image, take_serialized
import pytest
import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image
from std_msgs.msg import Header

MB = 1 << 20
PIXEL = WireImage(header=WireHeader(1, 2, 'camera'), height=1, width=1, encoding='mono8',
                  is_bigendian=False, step=1, data=b'\x07')


def large_image(value: int) -> WireImage:
    """Return an image of 6 MB."""
    return WireImage(header=WireHeader(value, 0, ''), height=1024, width=2048, encoding='bgr8',
                     is_bigendian=False, step=3 * 2048,
                     data=np.full(6 * MB, value % 256, np.uint8))


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
    deadline = time.monotonic() + DEADLINE
    while (taken := take_serialized(subscription.handle)) is None:
        assert time.monotonic() < deadline, 'no message came'
        time.sleep(0.001)
    return taken


def resident_bytes() -> int:
    """Return the resident memory of this process in bytes."""
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * 4096


@pytest.mark.parametrize('image', [
    PIXEL, large_image(200),
    replace(PIXEL, header=WireHeader(-1, 999_999_999, 'Kamera für 深度'), is_bigendian=True),
    replace(PIXEL, header=WireHeader(1, 2, ''), encoding=''),
    replace(PIXEL, step=2**32 - 1, data=b'')])
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


def test_array_that_is_not_contiguous(
        publisher: Publisher, subscription: Subscription) -> None:
    whole = np.arange(60 * 40 * 3, dtype=np.uint8).reshape(60, 40, 3)
    array = whole[::2, 5:25, ::-1]
    publish_image(publisher.handle, CvBridge().cv2_to_wire(array, 'bgr8', Header()))
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
    with pytest.raises(RuntimeError, match=r'\w+ \w+'):
        take_serialized(subscription_handle)


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


def test_subscription_destroyed_during_a_call(
        node: Node, publisher: Publisher, subscription: Subscription,
        monkeypatch: pytest.MonkeyPatch) -> None:
    publish_image(publisher.handle, PIXEL)
    assert publisher.wait_for_all_acked(Duration(seconds=DEADLINE))
    destroy_meanwhile(monkeypatch, 'rcl_take_serialized_message',
                      lambda: node.destroy_subscription(subscription))
    assert cdr_to_image(take_serialized(subscription.handle)[0]) == PIXEL
    with pytest.raises(RuntimeError, match=r'\w+ \w+'):
        take_serialized(subscription.handle)


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


def test_metadata_of_messages(
        publisher: Publisher, subscription: Subscription) -> None:
    began = time.time_ns()
    for _ in range(3):
        publish_image(publisher.handle, PIXEL)
    infos = [take(subscription)[1] for _ in range(3)]
    assert [info.number for info in infos] == [1, 2, 3]
    assert len({bytes(info.publisher) for info in infos}) == 1
    assert all(began <= info.source_timestamp <= info.received_timestamp <= time.time_ns()
               for info in infos)


@pytest.mark.parametrize(('given', 'number'), [(0, 0), (1, 1), (2**64 - 2, 2**64 - 2),
                                               (2**64 - 1, 0)])
def test_sequence_number(given: int, number: int) -> None:
    assert MessageInfo(publication_sequence_number=given).number == number


def test_read_only_data_after_the_subscription(
        node: Node, publisher: Publisher, subscription: Subscription) -> None:
    images = [large_image(value) for value in range(3)]
    for image in images:
        publish_image(publisher.handle, image)
    taken = [take(subscription)[0] for _ in images]
    node.destroy_subscription(subscription)
    messages = [cdr_to_image(data) for data in taken]
    del taken
    for message, image in zip(messages, images):
        assert message.header.sec == image.header.sec
        assert np.array_equal(np.frombuffer(message.data, np.uint8), image.data)
        assert message.data.readonly
        with pytest.raises(ValueError, match='read-only'):
            np.frombuffer(message.data, np.uint8)[0] = 1


def test_memory_of_taken_messages(
        publisher: Publisher, subscription: Subscription, tell: Callable[[str], None]) -> None:
    sizes = []
    for value in range(120):
        publish_image(publisher.handle, large_image(value))
        data, _ = take(subscription)
        assert data.nbytes > 6 * MB
        assert data[-1] == value % 256
        if value >= 20:
            sizes.append(resident_bytes())
    tell(f'{(sizes[-1] - sizes[0]) / MB:.1f} MB more after 100 images of 6 MB')
    assert sizes[-1] - sizes[0] < 30 * MB


class OtherImage(ctypes.Structure):
    """An image with an additional field."""

    _fields_ = (*zero_copy._Image._fields_[:4], ('depth', ctypes.c_uint64),
                *zero_copy._Image._fields_[4:])


class OtherArray(ctypes.Structure):
    """A serialized message with two fields swapped."""

    _fields_ = tuple(zero_copy._RmwSerializedMessage._fields_[index] for index in (0, 2, 1, 3))


@pytest.fixture
def use_rcl_again() -> Iterator[None]:
    """Select rcl again after a test."""
    yield
    assert zero_copy.use_rcl() == ''


@pytest.mark.parametrize(('name', 'value', 'reason'), [
    *(('_FUNCTIONS', {**zero_copy._FUNCTIONS, library: (f'{function}_gone',)}, f'{function}_gone')
      for library, functions in zero_copy._FUNCTIONS.items() for function in functions),
    ('_FUNCTIONS', {'librcl_gone.so': (), 'librcutils.so': ()}, 'librcl_gone.so'),
    ('_FUNCTIONS', {'librcl.so': (), 'librcutils_gone.so': ()}, 'librcutils_gone.so'),
    ('_Image', OtherImage, 'sensor_msgs__msg__Image has another layout'),
    ('_RmwSerializedMessage', OtherArray, 'rmw_serialized_message_t has another layout'),
    ('OPENCV_TOOLS_TRANSPORT', 'default', 'OPENCV_TOOLS_TRANSPORT is default'),
    ('ROS_DISTRO', 'kilted', 'ROS_DISTRO is kilted')])
def test_fallback_to_rclpy(
        use_rcl_again: None, publisher: Publisher, subscription: Subscription,
        name: str, value: Any, reason: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        if name.isupper() and not name.startswith('_'):
            patch.setenv(name, value)
        else:
            patch.setattr(zero_copy, name, value)
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
