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

"""Processor time of rectified images of 1920x1080, as ratios to a bare cv2.remap in one run."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
import statistics
import time
from typing import Any

import cv2
from figures import add_json_option, Figure, print_figures
import numpy as np
from opencv_tools.capture.frame import CapturedFrame
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.capture.rectified_image import RectifiedImage
from opencv_tools.capture.settings import CaptureSettings
from opencv_tools.frames import Frame
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.layout import array_to_wire
from opencv_tools.rectification import Rectifier
from sensor_msgs.msg import CameraInfo

WIDTH, HEIGHT = 1920, 1080
GOAL = 1.1

Work = Callable[[], Any]


def make_info() -> CameraInfo:
    """Return the calibration of a wide lens."""
    k = [1200.0, 0, 960, 0, 1200, 540, 0, 0, 1]
    return CameraInfo(
        width=WIDTH, height=HEIGHT, distortion_model='plumb_bob', d=[-0.3, 0.1, 0.0, 0.0, 0.0],
        k=k, r=np.eye(3).ravel(), p=[1100.0, 0, 960, 0, 0, 1100, 540, 0, 0, 0, 1, 0])


def processor_seconds(works: list[Work], rounds: int) -> list[float]:
    """Return the median times of all threads in functions that run in turn."""
    times: list[list[float]] = [[] for _ in works]
    for _ in range(rounds + 2):
        for work, seconds in zip(works, times, strict=True):
            began = time.process_time()
            result = work()
            seconds.append(time.process_time() - began)
            del result
    return [statistics.median(seconds[2:]) for seconds in times]


def measure(encoding_name: str, rounds: int) -> Iterator[Figure]:
    """Compare each way to a rectified image with cv2.remap and the same maps."""
    encoding, info = find_encoding(encoding_name), make_info()
    channels = () if encoding.channels == 1 else (encoding.channels,)
    image = np.random.default_rng(1).integers(
        0, 256, (HEIGHT, WIDTH, *channels)).astype(encoding.dtype)
    rectifier, out = Rectifier(), np.empty_like(image)
    message = array_to_wire(image, encoding)
    captured = CapturedFrame(image, encoding.name)
    rectifier.rectify(image, encoding, info)
    maps = rectifier._maps
    interpolation = cv2.INTER_NEAREST if encoding.is_generic else cv2.INTER_LINEAR

    def publish() -> Any:
        rectified = RectifiedImage(
            OutputImage(captured, CaptureSettings()), lambda: info, rectifier)
        rectified.lend = lambda *_: out
        return rectified.image

    ways: dict[str, tuple[Work, Work]] = {
        'Frame.rectified': (
            lambda: Frame(message, '', 0, info, rectifier).rectified,
            lambda: cv2.remap(image, *maps, interpolation)),
        'image_rect into shared memory': (
            publish, lambda: cv2.remap(image, *maps, interpolation, dst=out))}
    for name, (work, floor) in ways.items():
        seconds, bare = processor_seconds([work, floor], rounds)
        ratio = seconds / bare
        yield Figure('rectified', f'{name}, {encoding.name}, to a bare cv2.remap '
                     f'({bare * 1e3:.1f} ms)', ratio, 'x', f'at most {GOAL}', ratio <= GOAL)


def main() -> int:
    """Print each ratio with its goal."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rounds', type=int, default=51, help='runs to take the median of')
    add_json_option(parser)
    options = parser.parse_args()

    def figures() -> Iterator[Figure]:
        for name in ('bgr8', 'mono8', '16UC1'):
            yield from measure(name, options.rounds)
        (seconds,) = processor_seconds([lambda: Rectifier().rectify(
            np.zeros((HEIGHT, WIDTH), np.uint8), find_encoding('mono8'), make_info())], 7)
        yield Figure('rectified', 'maps of a calibration, once', seconds * 1e3, 'ms')

    print(f'{WIDTH}x{HEIGHT}, numpy {np.__version__}, OpenCV {cv2.__version__}')
    print_figures(figures(), options.json)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
