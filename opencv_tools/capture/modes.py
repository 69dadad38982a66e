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

"""Which of a camera's formats, sizes and rates to ask it for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from opencv_tools.capture.frame import JPEG
from opencv_tools.capture.pixel_formats import PIXEL_FORMATS
from opencv_tools.image.encodings import COLOR_ENCODINGS, find_encoding

#: What OpenCV asks a camera for, which most can do: width and height, frames per second.
USUAL_SIZE = (640, 480)
USUAL_RATE = 30.0


@dataclass(frozen=True)
class CameraRequest:
    """
    What is wanted of a camera; of what is left out the usual, or what comes nearest to it.

    :param width: in pixels; 0 for the usual one.
    :param height: in pixels; 0 for the usual one.
    :param fps: frames per second; 0.0 for the usual ones.
    :param fourcc: four letters of a pixel format; '' for the best one.
    :param encoding: what the frames are wanted in, which a raw format may already have.
    :param controls: settings to make, name and value; those that the camera lacks are passed by.
    """

    width: int = 0
    height: int = 0
    fps: float = 0.0
    fourcc: str = ''
    encoding: str = ''
    controls: tuple[tuple[str, int], ...] = ()


#: What is wanted when nothing is said.
NO_WISHES = CameraRequest()


@dataclass(frozen=True)
class Mode:
    """A pixel format in a size that a camera offers."""

    fourcc: str
    width: int
    height: int

    @property
    def size(self) -> str:
        """Write the size as ``640x480``."""
        return f'{self.width}x{self.height}'


def choose_mode(
    modes: Sequence[Mode], request: CameraRequest, rates: Callable[[Mode], Sequence[float]],
) -> Mode | None:
    """
    Choose the mode that comes nearest to what is wanted.

    The format that was named counts most, then an encoding that no other format can become, then
    the size, then the rate: at full size many cameras are slow but for one format.

    :param modes: what the camera offers.
    :param request: what is wanted.
    :param rates: gives the rates of a mode, empty when the camera does not tell.
    :returns: the mode, or None when there is none of a known format.
    """
    order = list(PIXEL_FORMATS)
    known = [mode for mode in modes if mode.fourcc in PIXEL_FORMATS]
    named = [mode for mode in known if mode.fourcc == request.fourcc] or known
    nearest = [min((mode for mode in named if mode.fourcc == fourcc),
                   key=lambda mode: _size_distance(mode, request))
               for fourcc in dict.fromkeys(mode.fourcc for mode in named)]

    def badness(mode: Mode) -> tuple[object, ...]:
        same = _is_sent(mode, request.encoding)
        return (not same and not _can_be_made(request.encoding), _size_distance(mode, request),
                _rate_distance(rates(mode), request.fps), not same, order.index(mode.fourcc))

    return min(nearest, key=badness, default=None)


def _is_sent(mode: Mode, encoding: str) -> bool:
    """Return whether the frames of a mode have the layout of an encoding, by any of its names."""
    sent = PIXEL_FORMATS[mode.fourcc].encoding
    return (sent != JPEG and bool(encoding)
            and find_encoding(sent).has_layout_of(find_encoding(encoding)))


def _can_be_made(encoding: str) -> bool:
    """Tell whether frames of any format can be converted to an encoding with nothing missing."""
    return not encoding or (encoding in COLOR_ENCODINGS and not encoding.endswith('16'))


def _size_distance(mode: Mode, request: CameraRequest) -> tuple[int, int]:
    usual_width, usual_height = USUAL_SIZE
    wanted = ((abs(mode.width - request.width) if request.width else 0)
              + (abs(mode.height - request.height) if request.height else 0))
    return wanted, abs(mode.width - usual_width) + abs(mode.height - usual_height)


def _rate_distance(rates: Sequence[float], wanted: float) -> float:
    if not rates:
        return 0.0
    if wanted:
        return min(abs(rate - wanted) for rate in rates)
    return max(0.0, USUAL_RATE - max(rates))


def describe_modes(modes: Sequence[Mode]) -> str:
    """List what a camera offers, the formats with the same sizes together."""
    sizes: dict[str, list[str]] = {}
    for mode in modes:
        sizes.setdefault(mode.fourcc, []).append(mode.size)
    formats: dict[str, list[str]] = {}
    for fourcc, offered in sizes.items():
        formats.setdefault(' '.join(offered), []).append(fourcc)
    return '; '.join(f'{" ".join(fourccs)} in {offered}' for offered, fourccs in formats.items())
