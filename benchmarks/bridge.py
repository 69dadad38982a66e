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

"""Time of cv_bridge, frames and CDR, as ratios to a memcpy and to OpenCV in one run."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
import statistics
import time
from typing import Any

import cv2
from figures import add_json_option, Figure, write_figures
import numpy as np
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.frames import Frame
from opencv_tools.image.cdr import cdr_to_image, image_to_cdr
from opencv_tools.image.encodings import declared_encoding, find_encoding
from opencv_tools.image.layout import array_to_wire
from opencv_tools.image_codecs import decode_image
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image

HD = (1080, 1920)
UHD = (2160, 3840)

BOUND = """
Limits of numpy: each operation passes over the memory once, which takes about 0.1 ms for two
bytes per pixel and 0.2 ms for four. Bytes that are not adjacent are read and written one per
cycle, which takes 0.6 ms per channel. Gray needs two such reads and 15 operations on two bytes.
YUV needs 30 operations, most of them on four bytes because its sums have 30 bits, and writes
every second column. Gray from a Bayer mosaic needs four bytes too. Swapping red and blue takes a
cycle per pixel; OpenCV swaps them at the speed of a copy.
"""

Work = Callable[[], Any]


@dataclass(frozen=True)
class Comparison:
    """
    A measured function, its reference and the goal.

    :param name: name of the function.
    :param work: the function of this package.
    :param against: name of the reference.
    :param other: the reference; None to measure microseconds.
    :param goal: largest ratio, or largest number of microseconds.
    """

    name: str
    work: Work
    against: str
    other: Work | None
    goal: float


def median_seconds(works: list[Work], rounds: int) -> list[float]:
    """Return the median times of functions that run in turn, so that a disturbance affects all."""
    times: list[list[float]] = [[] for _ in works]
    for _ in range(rounds + 2):
        for work, seconds in zip(works, times):
            began = time.perf_counter()
            result = work()
            seconds.append(time.perf_counter() - began)
            del result
    return [statistics.median(seconds[2:]) for seconds in times]


def copies(random: np.random.Generator) -> Iterator[Comparison]:
    """Compare what only moves bytes with a copy of the frame."""
    bridge = CvBridge()
    frame = random.integers(0, 256, (*HD, 3), np.uint8)
    other = np.empty_like(frame)
    message = bridge.cv2_to_imgmsg(frame, 'bgr8')
    received = bridge.imgmsg_to_cv2(message)

    def copy() -> None:
        np.copyto(other, frame)

    def copy_message() -> None:
        np.copyto(other, received)

    def upstreams_message() -> Image:
        filled = Image(height=HD[0], width=HD[1], encoding='bgr8', step=HD[1] * 3)
        filled.data.frombytes(frame.tobytes())
        return filled

    def to_cdr() -> bytes:
        return image_to_cdr(array_to_wire(frame, declared_encoding(frame, 'bgr8')))

    def to_message() -> Image:
        return bridge.cv2_to_imgmsg(frame, 'bgr8')

    yield Comparison('cv2_to_imgmsg bgr8', to_message, 'a copy', copy, 1.15)
    yield Comparison('cv2_to_imgmsg bgr8', to_message, 'tobytes, frombytes', upstreams_message,
                     0.6)
    yield Comparison('imgmsg_to_cv2 bgr8 to bgr8', lambda: bridge.imgmsg_to_cv2(message, 'bgr8'),
                     'a copy', copy_message, 1.1)
    yield Comparison('array to CDR bgr8', to_cdr, 'a copy', copy, 1.15)
    yield Comparison('array to CDR bgr8', to_cdr, 'a message, rclpy',
                     lambda: serialize_message(upstreams_message()), 0.3)
    large = bridge.cv2_to_imgmsg(random.integers(0, 256, (*UHD, 3), np.uint8), 'bgr8')
    serialized = serialize_message(large)
    yield Comparison('imgmsg_to_cv2 passthrough, 4K', lambda: bridge.imgmsg_to_cv2(large),
                     'microseconds', None, 10)
    yield Comparison('CDR to array, 4K', lambda: bridge.imgmsg_to_cv2(cdr_to_image(serialized)),
                     'microseconds', None, 20)


def conversions(random: np.random.Generator) -> Iterator[Comparison]:
    """Compare conversions with those of OpenCV on one thread."""
    bridge = CvBridge()
    gray16 = random.integers(0, 2**16, HD, np.uint16)
    images = {
        'bgr8': random.integers(0, 256, (*HD, 3), np.uint8),
        'bgra8': random.integers(0, 256, (*HD, 4), np.uint8),
        'mono8': gray16.astype(np.uint8),
        'mono16': gray16,
        'uyvy': random.integers(0, 256, (*HD, 2), np.uint8),
        'nv12': random.integers(0, 256, (HD[0] * 3 // 2, HD[1]), np.uint8),
        'bayer_rggb8': gray16.astype(np.uint8),
    }
    messages = {name: bridge.cv2_to_imgmsg(image, name) for name, image in images.items()}

    def compare(source: str, desired: str, goal: float, other: Work) -> Comparison:
        return Comparison(f'{source} to {desired}',
                          lambda: bridge.imgmsg_to_cv2(messages[source], desired),
                          'OpenCV', other, goal)

    def opencv(source: str, code: int) -> Work:
        return lambda: cv2.cvtColor(images[source], code)

    yield compare('bgr8', 'rgb8', 3, opencv('bgr8', cv2.COLOR_BGR2RGB))
    yield compare('bgr8', 'bgra8', 3, opencv('bgr8', cv2.COLOR_BGR2BGRA))
    yield compare('bgr8', 'rgba8', 3, opencv('bgr8', cv2.COLOR_BGR2RGBA))
    yield compare('bgra8', 'bgr8', 3, opencv('bgra8', cv2.COLOR_BGRA2BGR))
    yield compare('bgra8', 'rgb8', 3, opencv('bgra8', cv2.COLOR_BGRA2RGB))
    yield compare('bgr8', 'mono8', 3, opencv('bgr8', cv2.COLOR_BGR2GRAY))
    yield compare('mono16', 'mono8', 3, lambda: cv2.convertScaleAbs(gray16, alpha=1 / 257))
    yield compare('mono8', 'mono16', 1,
                  lambda: cv2.multiply(images['mono8'], 257.0, dtype=cv2.CV_16U))
    yield compare('uyvy', 'bgr8', 5, opencv('uyvy', cv2.COLOR_YUV2BGR_UYVY))
    yield compare('uyvy', 'mono8', 5, opencv('uyvy', cv2.COLOR_YUV2GRAY_UYVY))
    yield compare('nv12', 'bgr8', 5, opencv('nv12', cv2.COLOR_YUV2BGR_NV12))
    yield compare('bayer_rggb8', 'bgr8', 5, opencv('bayer_rggb8', cv2.COLOR_BayerBG2BGR))
    yield compare('bayer_rggb8', 'mono8', 5, opencv('bayer_rggb8', cv2.COLOR_BayerBG2GRAY))


def jpegs() -> Iterator[Comparison]:
    """Compare the decoding of a JPEG into given memory with that of OpenCV and a copy."""
    columns, rows = np.meshgrid(np.arange(HD[1]), np.arange(HD[0]))
    image = np.stack([columns % 256, rows % 256, (columns + rows) % 256], -1).astype(np.uint8)
    content = cv2.imencode('.jpg', cv2.GaussianBlur(image, (0, 0), 3))[1].tobytes()
    out = np.empty_like(image)
    yield Comparison('a JPEG into memory',
                     lambda: decode_image(content, lend=lambda *_: out), 'decode, copy',
                     lambda: np.copyto(out, decode_image(content)), 1)


def frames(random: np.random.Generator) -> Iterator[Comparison]:
    """Compare conversions of frames with those of cv_bridge."""
    bridge = CvBridge()

    def compare(source: str, desired: str) -> Comparison:
        channels = find_encoding(source).channels
        shape = HD if channels == 1 else (*HD, channels)
        image = random.integers(0, 256, shape, np.uint8)
        message = array_to_wire(image, find_encoding(source))
        return Comparison(f'Frame.to {source} to {desired}',
                          lambda: Frame(message).to(desired), 'cv_bridge',
                          lambda: bridge.imgmsg_to_cv2(message, desired), 0.6)

    yield compare('bgr8', 'mono8')
    yield compare('bgr8', 'rgb8')
    yield compare('bayer_rggb8', 'bgr8')
    yield compare('yuyv', 'bgr8')


def main() -> int:
    """Print each comparison with its goal."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rounds', type=int, default=31, help='runs to take the median of')
    add_json_option(parser)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    random = np.random.default_rng(1)
    print(f'{HD[1]}x{HD[0]}, one thread, medians of {options.rounds}, '
          f'numpy {np.__version__}, OpenCV {cv2.__version__}')
    print(f'{"":32}{"ms":>8}  {"against":20}{"ms":>8}{"ratio":>8}{"goal":>7}')
    figures = []
    for comparison in (*copies(random), *conversions(random), *jpegs(), *frames(random)):
        if comparison.other is None:
            (seconds,) = median_seconds([comparison.work], options.rounds)
            name, unit, other, reached = comparison.name, 'us', '', seconds * 1e6
        else:
            seconds, floor = median_seconds([comparison.work, comparison.other], options.rounds)
            name, unit = f'{comparison.name} against {comparison.against}', 'x'
            other, reached = f'{floor * 1e3:.3f}', seconds / floor
        met = reached <= comparison.goal
        figures.append(Figure('bridge', name, reached, unit, f'at most {comparison.goal:g}', met))
        verdict = '' if met else '  over'
        print(f'{comparison.name:32}{seconds * 1e3:8.3f}  {comparison.against:20}{other:>8}'
              f'{reached:8.2f}{comparison.goal:7g}{verdict}')
    if not all(figure.met for figure in figures):
        print(BOUND.rstrip())
    if options.json:
        write_figures(options.json, figures)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
