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

"""Print the results of the commands and conversions as JSON: python results.py PROJECT."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import hashlib
import io
import json
from pathlib import Path
import platform
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.convert.cli import main as img_convert
from opencv_tools.image.cdr import cdr_to_image, image_to_cdr, WireHeader
from opencv_tools.image.color import convert
from opencv_tools.image.encodings import COLOR_ENCODINGS, ENCODINGS
from opencv_tools.image.layout import array_to_wire, view_image
from opencv_tools.robot.cli import robot_compare, robot_frames, sdf_to_urdf, urdf_to_sdf

HEIGHT, WIDTH = 34, 30

# Conversions of files: subject, source, target, options. Each target is read by the next line.
FILES = (
    ('video, 10 frames', 'test/data/big_buck_bunny_720p.mp4', 'video/{seq:03d}.npy',
     ('--stop', '10')),
    ('pattern', 'pattern:320x240@10', 'pattern/{seq:03d}.npy', ('--stop', '5')),
    ('pattern to PNG', 'pattern:320x240@10', 'png/{seq:03d}.png', ('--stop', '5')),
    ('PNG to bag', 'png', 'frames.mcap', ()),
    ('bag to arrays', 'frames.mcap', 'bag/{seq:03d}.npy', ()),
)


def run(command: Callable[[list[str]], int], *arguments: object) -> str:
    """Return the exit status of a command and the text that it prints."""
    printed = io.BytesIO()
    texts = io.TextIOWrapper(printed), io.TextIOWrapper(io.BytesIO())
    with contextlib.redirect_stdout(texts[0]), contextlib.redirect_stderr(texts[1]):
        status = command([*map(str, arguments)])
        sys.stdout.flush()
    return f'exit status {status}\n{printed.getvalue().decode()}'


def digest(data: bytes | NDArray[Any]) -> str:
    """Return a short hash of data."""
    return hashlib.sha256(data).hexdigest()[:16]


def rounded(image: NDArray[Any]) -> str:
    """
    Return the mean colours of 4x4 parts of an image, of which run.py allows small differences.

    FFmpeg converts the colours of videos by other instructions on each processor.
    """
    parts = image.reshape(4, image.shape[0] // 4, 4, image.shape[1] // 4, -1).mean((1, 3))
    return ' '.join(f'~{value:.1f}' for value in parts.reshape(-1))


def robots(project: Path) -> Iterator[tuple[str, str]]:
    """Yield the subject and the result of each command for robots."""
    pair = project / 'urdf/my_arm.urdf', project / 'sdf/my_arm/model.sdf'
    yield 'robot_compare my_arm', run(robot_compare, *pair)
    for suffix, command in (('urdf', urdf_to_sdf), ('sdf', sdf_to_urdf)):
        for path in sorted((project / 'test/data/robots' / suffix).glob(f'ok_*.{suffix}')):
            yield f'{command.__name__} {path.stem}', run(command, path)
            yield f'robot_frames {path.stem}', run(robot_frames, path)


def conversions() -> Iterator[tuple[str, str]]:
    """Yield each conversion of encodings and the hash of its pixels, sent as CDR before."""
    random = np.random.default_rng(7)
    for source in ENCODINGS.values():
        data = random.bytes(source.size(HEIGHT, WIDTH))
        image = view_image(data, HEIGHT, WIDTH, source)
        message = image_to_cdr(array_to_wire(image, source, WireHeader(1, 2, 'camera')))
        yield f'{source.name} to CDR', digest(message)
        received = view_image(cdr_to_image(message).data, HEIGHT, WIDTH, source)
        for target in COLOR_ENCODINGS:
            pixels = convert(received, source, ENCODINGS[target])
            yield f'{source.name} to {target}', digest(np.ascontiguousarray(pixels))


def files(project: Path) -> Iterator[tuple[str, str]]:
    """Yield the subject and the hash of the files of each ``img_convert``."""
    for subject, source, target, options in FILES:
        if source.startswith('test/'):
            source = str(project / source)
        result = run(img_convert, source, target, *options)
        summary = rounded if source.endswith('.mp4') else digest
        pixels = [summary(np.load(path)) for path in sorted(Path(target).parent.glob('*.npy'))]
        yield f'img_convert {subject}', ' '.join((result.splitlines()[0], *pixels))


def main(project: Path) -> None:
    """Print the results; files are written to the current folder."""
    results = dict((*robots(project), *conversions(), *files(project)))
    print(json.dumps({'machine': platform.machine(), 'results': results}))


if __name__ == '__main__':
    main(Path(sys.argv[1]))
