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

"""Enumeration of the formats, sizes and rates that a V4L2 camera supports."""

from __future__ import annotations

from collections.abc import Iterator
import itertools

from opencv_tools.capture.v4l2 import videodev2
from opencv_tools.capture.v4l2.modes import Mode
from opencv_tools.capture.v4l2.pixel_formats import pack_fourcc, unpack_fourcc
from opencv_tools.capture.v4l2.videodev2 import try_ioctl


def list_modes(fd: int, buffer_type: int, near: tuple[int, int]) -> Iterator[Mode]:
    """
    Yield the formats and sizes of an open device.

    :param fd: descriptor of the device.
    :param buffer_type: ``V4L2_BUF_TYPE_VIDEO_CAPTURE`` or ``V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE``.
    :param near: width and height in pixels; for a format with a range of sizes, only the size
        nearest to ``near`` is yielded.
    :raises OSError: the device is disconnected.
    """
    for index in itertools.count():
        description = videodev2.v4l2_fmtdesc(index=index, type=buffer_type)
        if not try_ioctl(fd, videodev2.VIDIOC_ENUM_FMT, description):
            return
        fourcc = unpack_fourcc(description.pixelformat)
        for size in _sizes(fd, fourcc, near):
            yield Mode(fourcc, *size)


def list_rates(fd: int, mode: Mode) -> Iterator[float]:
    """
    Yield the frame rates of a mode in Hz.

    Yields both ends of a range of rates, and nothing when the device does not report rates.

    :param fd: descriptor of the device.
    :param mode: format and size.
    :raises OSError: the device is disconnected.
    """
    for index in itertools.count():
        interval = videodev2.v4l2_frmivalenum(
            index=index, pixel_format=pack_fourcc(mode.fourcc),
            width=mode.width, height=mode.height)
        if not try_ioctl(fd, videodev2.VIDIOC_ENUM_FRAMEINTERVALS, interval):
            return
        if interval.type == videodev2.V4L2_FRMIVAL_TYPE_DISCRETE:
            yield per_second(interval.discrete)
        else:
            yield per_second(interval.stepwise.min)
            yield per_second(interval.stepwise.max)


def per_second(interval: videodev2.v4l2_fract) -> float:
    """Return the rate of a frame interval in Hz; 0.0 when the device does not report it."""
    return interval.denominator / interval.numerator if interval.numerator else 0.0


def _sizes(fd: int, fourcc: str, near: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """Yield the sizes of a format; ``near`` itself when the device does not report sizes."""
    for index in itertools.count():
        size = videodev2.v4l2_frmsizeenum(index=index, pixel_format=pack_fourcc(fourcc))
        if not try_ioctl(fd, videodev2.VIDIOC_ENUM_FRAMESIZES, size):
            if index == 0:
                yield near
            return
        if size.type == videodev2.V4L2_FRMSIZE_TYPE_DISCRETE:
            yield size.discrete.width, size.discrete.height
        else:
            steps = size.stepwise
            yield (_round_down(near[0], steps.min_width, steps.max_width, steps.step_width),
                   _round_down(near[1], steps.min_height, steps.max_height, steps.step_height))


def _round_down(number: int, least: int, most: int, step: int) -> int:
    """Round a number down to a step of the range from ``least`` to ``most``; 0 is a step of 1."""
    return least + (min(max(number, least), most) - least) // max(1, step) * max(1, step)
