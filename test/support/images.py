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

"""Random images, and the results of cv_bridge for them, recorded or from a process."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
import pickle
import shutil
import struct
import subprocess

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.capture.pattern import PatternSource, PatternSpec
from opencv_tools.image.cdr import NO_HEADER, WireHeader, WireImage
from opencv_tools.image.encodings import find_encoding
from waiting import LONGEST_SECONDS

DATA = Path(__file__).parents[1] / 'data'
RANDOM = np.random.default_rng(2)

# Letters of the recorded outcomes, and the text of the error of each one.
ERRORS = {
    'U': 'Unsupported conversion from [{0}] to [{1}]',
    'S': '[{0}] is not a color format. but [{1}] is. The conversion does not make sense',
    'N': '[{0}] and [{1}] do not have the same number of channel',
    'T': '[{0}] is a color format but [{1}] is not so they must have the same OpenCV type, '
         'CV_8UC3, CV16UC1 ....',
    'D': 'Unknown encoding {1}',
    'F': 'Unknown encoding {0}',
    'R': 'Unrecognized image encoding [{1}]',
}


def random_image(encoding: str, height: int, width: int) -> np.ndarray:
    """Return random values over the whole range of a type, with NaN and infinity for floats."""
    found = find_encoding(encoding)
    rows = found.rows(height)
    shape = (rows, width) if found.channels == 1 else (rows, width, found.channels)
    dtype = np.dtype(found.dtype)
    if dtype.kind != 'f':
        limits = np.iinfo(dtype)
        return RANDOM.integers(limits.min, limits.max, shape, dtype, endpoint=True)
    image = RANDOM.normal(0, 10.0 ** RANDOM.integers(0, 11), shape).astype(dtype)
    image.flat[::7] = np.round(image.flat[::7]) + 0.5
    for first, special in enumerate((np.nan, np.inf, -np.inf, 2.0**31, -2.0**31)):
        image.flat[5 + first::29] = special
    return image


def padded_image(image: np.ndarray, encoding: str, padding: int, is_bigendian: bool = False,
                 header: WireHeader = NO_HEADER) -> WireImage:
    """Return the message of an image, with bytes that are no pixels at the end of each row."""
    found = find_encoding(encoding)
    rows, width = image.shape[:2]
    height, row = found.height(rows), width * found.pixel_bytes
    order = '>' if is_bigendian else '<'
    lines = [line.tobytes() for line in image.astype(image.dtype.newbyteorder(order))]
    if found.row_factor == 3:  # a chroma line of nv24 has two rows, and the padding of two
        chroma = [first + second for first, second in zip(lines[height::2], lines[height + 1::2])]
        data = b''.join([*(line + padding * b'x' for line in lines[:height]),
                         *(line + 2 * padding * b'x' for line in chroma)])
    else:
        data = b''.join(line + padding * b'x' for line in lines)
    return WireImage(header=header, height=height, width=width, encoding=encoding,
                     is_bigendian=is_bigendian, step=row + padding, data=data)


def recorded_outcomes() -> dict[tuple[str, str], str | None]:
    """Read the recorded outcome of each conversion: None for a success, otherwise the error."""
    lines = [line.split() for line in (DATA / 'cv_bridge_outcomes.txt').read_text().splitlines()
             if not line.startswith('#')]
    desired = ['' if name == "''" else name for name in lines[0][1:]]
    return {(source, name): ERRORS[letter].format(source, name) if letter in ERRORS else None
            for source, letters in lines[1:] for name, letter in zip(desired, letters)}


#: Function that rotates an image upright, by its Exif orientation.
UPRIGHT: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    1: lambda image: image,
    2: lambda image: image[:, ::-1],
    3: lambda image: image[::-1, ::-1],
    4: lambda image: image[::-1],
    5: lambda image: np.swapaxes(image, 0, 1),
    6: lambda image: np.rot90(image, -1),  # the camera was held with its left side up
    7: lambda image: np.swapaxes(image[::-1, ::-1], 0, 1),
    8: np.rot90,
}


def oriented_jpeg(image: np.ndarray, orientation: int) -> bytes:
    """Return a JPEG with an Exif orientation."""
    entry = struct.pack('>HHIHH', 0x0112, 3, 1, orientation, 0)
    exif = b'Exif\0\0' + b'MM\0*' + struct.pack('>IH', 8, 1) + entry + bytes(4)
    jpeg = cv2.imencode('.jpg', image)[1].tobytes()
    return jpeg[:2] + b'\xff\xe1' + struct.pack('>H', 2 + len(exif)) + exif + jpeg[2:]


_ORACLE = """
import pickle, sys
import numpy as np
from cv_bridge.boost.cv_bridge_boost import cvtColor2
from cv2 import __version__ as version

answers = []
for source, dtype, shape, data, desired in pickle.load(sys.stdin.buffer):
    try:
        image = cvtColor2(np.frombuffer(data, dtype).reshape(shape).copy(), source, desired)
        answers.append((image.dtype.str, image.shape, image.tobytes()))
    except Exception as err:
        answers.append(str(err))
pickle.dump((version, answers), sys.stdout.buffer, 2)
"""


def ask_cv_bridge(
    jobs: Iterable[tuple[str, np.ndarray, str]],
) -> tuple[str, list[np.ndarray | str]] | None:
    """
    Convert images with the cv_bridge of the system, in a process of the system's Python.

    :param jobs: encoding, image and desired encoding of each conversion.
    :returns: the version of OpenCV, and an image or the text of an error for each job; None if
        the system has no cv_bridge.
    """
    request = pickle.dumps([(source, image.dtype.str, image.shape, image.tobytes(), desired)
                            for source, image, desired in jobs], 2)
    python = shutil.which('python3', path='/usr/bin')
    finished = subprocess.run(
        [python, '-c', _ORACLE], input=request, capture_output=True, timeout=LONGEST_SECONDS,
        check=False) if python else None
    if not finished or finished.returncode:
        return None
    version, answers = pickle.loads(finished.stdout)
    return version, [
        answer if isinstance(answer, str)
        else np.frombuffer(answer[2], answer[0]).reshape(answer[1]) for answer in answers]


def draw_pattern(number: int, width: int, height: int) -> NDArray[np.uint8]:
    """Return a frame of the source ``pattern``, (h, w, 3) in BGR."""
    source = PatternSource(PatternSpec(width, height))
    for _ in range(number):
        source.skip()
    return source.read().image


def find_numbers(pictures: list[np.ndarray]) -> list[int]:
    """Find which frames of the pattern pictures are, every pixel of them, in rising order."""
    numbers = [-1]
    for picture in pictures:
        height, width = picture.shape[:2]
        numbers.append(next(number for number in range(numbers[-1] + 1, 10_000)
                            if np.array_equal(picture, draw_pattern(number, width, height))))
    return numbers[1:]
