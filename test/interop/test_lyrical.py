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

"""The layout of an image message of ROS 2 Lyrical, with structures that a compiler has made."""

from __future__ import annotations

import ctypes
from pathlib import Path
import subprocess
from typing import Any

import numpy as np
from opencv_tools.image.cdr import WireHeader, WireImage
from opencv_tools.transport import rcl_structures, zero_copy
from opencv_tools.transport.rcl_structures import (
    find_image_layout, image_converter, RclBufferImage, RclImage, RclSequence)
import pytest

SOURCE = Path(__file__).with_name('lyrical_image.cpp')


@pytest.fixture(scope='module')
def lyrical(tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp('lyrical') / 'lyrical.so'
    subprocess.run(['g++', '-shared', '-fPIC', '-o', path, SOURCE], check=True)
    library = ctypes.CDLL(str(path))
    create = library.sensor_msgs__msg__Image__Sequence__create
    create.restype = ctypes.POINTER(RclSequence)
    library.sensor_msgs__msg__Image__Sequence__destroy.argtypes = [ctypes.POINTER(RclSequence)]
    library.sensor_msgs__msg__Image__fini.argtypes = library.sum.argtypes = [ctypes.c_void_p]
    library.sum.restype = ctypes.c_uint64
    library.fill.argtypes = [
        ctypes.c_void_p, ctypes.c_int32, ctypes.c_uint32, ctypes.c_char_p, ctypes.c_uint32,
        ctypes.c_uint32, ctypes.c_char_p, ctypes.c_uint8, ctypes.c_uint32, ctypes.c_char_p,
        ctypes.c_size_t, ctypes.c_bool]
    return library


def fill(library: Any, message: Any, address: int, is_rosidl_buffer: bool = False) -> bool:
    """Convert a message of rclpy, as the converter of Lyrical does."""
    header = message.header
    library.fill(address, header.stamp.sec, header.stamp.nanosec, header.frame_id.encode(),
                 message.height, message.width, message.encoding.encode(), message.is_bigendian,
                 message.step, bytes(message.data), len(message.data), is_rosidl_buffer)
    return True


def test_layout_is_found(lyrical: Any) -> None:
    assert lyrical.size_of_image() == ctypes.sizeof(RclBufferImage)
    assert lyrical.size_of_image() == ctypes.sizeof(RclImage) + 8
    assert find_image_layout(
        lyrical, lambda message, address: fill(lyrical, message, address)) is RclBufferImage
    assert find_image_layout(
        lyrical, lambda message, address: fill(lyrical, message, address, True)) is None
    # The installed release has the earlier layout.
    assert find_image_layout(zero_copy._sensor_msgs, image_converter()) is RclImage


def test_images_of_lyrical_are_published_and_taken(
        lyrical: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the functions of rcl are replaced, which Lyrical alone has in this layout."""
    data = np.arange(24, dtype=np.uint8)
    image = WireImage(header=WireHeader(1, 2, 'eye'), height=2, width=4, encoding='bgr8',
                      is_bigendian=False, step=12, data=data.data)
    sums: list[int] = []

    class Rcl:
        is_rosidl_buffer = False

        def rcl_publish(self, publisher: int, message: Any, _: None) -> int:
            sums.append(lyrical.sum(ctypes.addressof(message._obj)))
            return 0

        def rcl_take(self, subscription: int, address: int, *_: Any) -> int:
            lyrical.fill(address, 1, 2, b'eye', 2, 4, b'bgr8', 0, 12, data.tobytes(), data.size,
                         self.is_rosidl_buffer)
            return 0

    class Handle:
        pointer = 0

        def __enter__(self) -> None:
            pass

        __exit__ = lambda *_: None  # noqa: E731

    monkeypatch.setattr(zero_copy, '_rcl', rcl := Rcl())
    monkeypatch.setattr(zero_copy, '_sensor_msgs', lyrical)
    monkeypatch.setattr(zero_copy, '_image_layout', rcl_structures.RclBufferImage)
    zero_copy.publish_image(Handle(), image)
    assert sums == [1 + 2 + 2 + 4 + 12 + len('eye') + len('bgr8') + int(data.sum())]
    taken = zero_copy.take_image(Handle()).image
    assert taken is not None
    assert bytes(taken.data) == data.tobytes()
    assert (taken.header, taken.height, taken.width, taken.encoding, taken.step) == (
        image.header, 2, 4, 'bgr8', 12)
    rcl.is_rosidl_buffer = True
    found = zero_copy.take_image(Handle())
    assert (found.image, found.unreadable) == (None, 'its data are in a rosidl::Buffer')
