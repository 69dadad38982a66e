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

"""Formats, sizes and rates that a camera supports, and the choice of the requested ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
import itertools

from opencv_tools.base.parameter_fields import parameter, rate_parameter
from opencv_tools.capture.frame import JPEG, MAX_RATE, VIDEO
from opencv_tools.capture.v4l2 import videodev2
from opencv_tools.capture.v4l2.pixel_formats import (
    check_fourcc, pack_fourcc, PIXEL_FORMATS, unpack_fourcc)
from opencv_tools.capture.v4l2.videodev2 import try_ioctl
from opencv_tools.image.encodings import COLOR_ENCODINGS, ENCODINGS, find_encoding

#: Default size in pixels (width, height) and rate in Hz. Most cameras support these defaults of
#: OpenCV.
DEFAULT_SIZE = (640, 480)
DEFAULT_RATE = 30.0


@dataclass(frozen=True, kw_only=True)
class CameraRequest:
    """
    Requested camera settings. Unset fields use the default or the closest supported value.

    :param width: width in pixels; 0 for the default (640).
    :param height: height in pixels; 0 for the default (480).
    :param fps: frames per second; 0.0 for the default (30).
    :param fourcc: pixel format, one of ``PIXEL_FORMATS``; '' to choose the best one.
    :param encoding: encoding in which frames are published; a raw format that already has this
        encoding is preferred. '' for no preference.
    :param controls: name and value of each control to set; controls that the camera does not
        have are ignored.
    """

    width: int = parameter(
        0, 'Width of the camera image in pixels; 0 for the default (640)', bounds=(0, 1 << 16),
        changeable=True, other_names=('image_width', 'image_size'))
    height: int = parameter(
        0, 'Height of the camera image in pixels; 0 for the default (480)', bounds=(0, 1 << 16),
        changeable=True, other_names=('image_height', 'image_size'))
    fps: float = rate_parameter(
        0.0, 'Frame rate requested from the camera in Hz; 0 for the default (30)', MAX_RATE,
        changeable=True, other_names=('framerate', 'frame_rate', 'time_per_frame'))
    fourcc: str = parameter(
        '', 'Pixel format requested from the camera, such as YUYV or MJPG; empty for the best '
        'format at this size and rate', check=check_fourcc, changeable=True,
        other_names=('pixel_format', 'color_format'))
    encoding: str = parameter(
        '', "Encoding of the published images, such as '16UC1' for depth in files of mono16; '' "
        'for the encoding of the source', choices=(*ENCODINGS, '16UC1', ''), changeable=True,
        other_names=('output_encoding', 'image_encoding'))
    controls: tuple[tuple[str, int], ...] = ()


#: The request with all defaults.
DEFAULT_REQUEST = CameraRequest()


@dataclass(frozen=True)
class Mode:
    """
    A pixel format and size that a camera supports.

    :param fourcc: pixel format, as ``unpack_fourcc`` writes it.
    :param width: width in pixels.
    :param height: height in pixels.
    """

    fourcc: str
    width: int
    height: int

    @property
    def size(self) -> str:
        """Size as text, such as ``640x480``."""
        return f'{self.width}x{self.height}'


def list_modes(fd: int, buffer_type: int, near: tuple[int, int]) -> Iterator[Mode]:
    """
    Yield the formats and sizes of an open device.

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


def choose_mode(
    modes: Sequence[Mode], request: CameraRequest, rates: Callable[[Mode], Sequence[float]],
) -> Mode | None:
    """
    Return the mode that is closest to a request.

    Criteria in order: the requested pixel format; an encoding to which other formats cannot be
    converted; the size; the rate; the requested encoding; the order of ``PIXEL_FORMATS``. The
    rate matters because many cameras reach their full rate at full size in one format only. H.264
    is chosen if it is requested, or the only format.

    :param modes: modes that the camera supports.
    :param rates: function that returns the rates of a mode in Hz; empty when the camera does not
        report them.
    :returns: the mode, or None when the camera supports no known pixel format.
    """
    order = list(PIXEL_FORMATS)
    known = [mode for mode in modes if mode.fourcc in PIXEL_FORMATS]
    named = ([mode for mode in known if mode.fourcc == request.fourcc]
             or [mode for mode in known if PIXEL_FORMATS[mode.fourcc].encoding != VIDEO] or known)
    nearest = [min((mode for mode in named if mode.fourcc == fourcc),
                   key=lambda mode: _size_distance(mode, request))
               for fourcc in dict.fromkeys(mode.fourcc for mode in named)]

    def cost(mode: Mode) -> tuple[object, ...]:
        same = _has_encoding(mode, request.encoding)
        return (not same and not _can_convert_to(request.encoding), _size_distance(mode, request),
                _rate_distance(rates(mode), request.fps), not same, order.index(mode.fourcc))

    return min(nearest, key=cost, default=None)


def _has_encoding(mode: Mode, encoding: str) -> bool:
    """Return whether the frames of a mode have the layout of an encoding."""
    sent = PIXEL_FORMATS[mode.fourcc].encoding
    return (sent not in (JPEG, VIDEO) and bool(encoding)
            and find_encoding(sent).has_layout_of(find_encoding(encoding)))


def _can_convert_to(encoding: str) -> bool:
    """Return whether all pixel formats can be converted to an encoding without loss of depth."""
    return not encoding or (encoding in COLOR_ENCODINGS and not encoding.endswith('16'))


def _size_distance(mode: Mode, request: CameraRequest) -> tuple[int, int]:
    default_width, default_height = DEFAULT_SIZE
    distance = ((abs(mode.width - request.width) if request.width else 0)
                + (abs(mode.height - request.height) if request.height else 0))
    return distance, abs(mode.width - default_width) + abs(mode.height - default_height)


def _rate_distance(rates: Sequence[float], requested: float) -> float:
    if not rates:
        return 0.0
    if requested:
        return min(abs(rate - requested) for rate in rates)
    return max(0.0, DEFAULT_RATE - max(rates))


def describe_modes(modes: Sequence[Mode]) -> str:
    """
    Return modes as text for a message.

    :returns: for example ``YUYV MJPG in 640x480 320x240; GREY in 640x480``: formats with the same
        sizes are grouped.
    """
    sizes: dict[str, list[str]] = {}
    for mode in modes:
        sizes.setdefault(mode.fourcc, []).append(mode.size)
    formats: dict[str, list[str]] = {}
    for fourcc, offered in sizes.items():
        formats.setdefault(' '.join(offered), []).append(fourcc)
    return '; '.join(f'{" ".join(fourccs)} in {offered}' for offered, fourccs in formats.items())
