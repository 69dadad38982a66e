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

"""Speed of img_convert against one loop of OpenCV, and the start of its help."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import redirect_stderr
import io
from pathlib import Path
import shutil
import statistics
import subprocess
import sys
import time

import av
import cv2
from figures import Figure
from opencv_tools.bags.schemas import COMPRESSED_IMAGE
from opencv_tools.bags.writing import BagChannel, BagWriter
from opencv_tools.convert.cli import main as img_convert
from opencv_tools.image.cdr import compressed_image_to_cdr, WireCompressedImage, WireHeader

CLIP = Path(__file__).resolve().parent.parent / 'test/data/big_buck_bunny_720p.mp4'
SIZE = (1920, 1080)
FRAMES = 90
ROUNDS = 3
STARTS = 9
TOPIC = '/camera/image_raw/compressed'

PNG_SPEEDUP, JPEG_SPEEDUP, HELP_SECONDS = 1.8, 10.0, 0.15  # goals


def converting(folder: Path) -> list[Figure]:
    """
    Measure the conversion of a 1080p video to PNG, and of the JPEGs of a bag to files.

    :param folder: folder for the files, on the disk to measure.
    :returns: frames per second of img_convert divided by those of the loop.
    """
    video, bag = folder / 'clip.mp4', folder / 'clip.mcap'
    _write_sources(video, bag)
    return [
        _race('1080p H.264 to PNG', PNG_SPEEDUP, folder, lambda out: _video_loop(video, out),
              (str(video), '{seq:06d}.png')),
        _race('1080p JPEGs of a bag to files', JPEG_SPEEDUP, folder,
              lambda out: _jpeg_loop(bag, out), (str(bag), '{seq:06d}.jpg'))]


def help_start() -> list[Figure]:
    """Measure the time of ``img_convert --help``: the median of several processes."""
    command = [sys.executable, '-c', 'from opencv_tools.convert.cli import main; main()', '--help']
    times = []
    for _ in range(STARTS):
        began = time.perf_counter()
        subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
        times.append(time.perf_counter() - began)
    seconds = statistics.median(times)
    print(f'img_convert --help: {seconds:.3f} s (at most {HELP_SECONDS})')
    return [Figure('bags', 'img_convert --help', seconds, 's', f'at most {HELP_SECONDS}',
                   seconds <= HELP_SECONDS)]


def _race(
    name: str, goal: float, folder: Path, loop: Callable[[Path], None], words: tuple[str, str],
) -> Figure:
    """Return the speed of img_convert divided by that of a loop, in alternating rounds."""
    def convert(out: Path) -> None:
        with redirect_stderr(io.StringIO()) as console:
            status = img_convert([words[0], str(out / words[1])])
        if status:
            raise SystemExit(console.getvalue())

    times: dict[Callable[[Path], None], list[float]] = {loop: [], convert: []}
    for _ in range(ROUNDS):
        for way, seconds in times.items():
            out = folder / 'out'
            out.mkdir()
            began = time.perf_counter()
            way(out)
            seconds.append(time.perf_counter() - began)
            if len(list(out.glob('[0-9]*'))) != FRAMES:
                raise SystemExit(f'{name}: not every frame was written')
            shutil.rmtree(out)
    rates = [FRAMES / statistics.median(seconds) for seconds in times.values()]
    ratio = rates[1] / rates[0]
    print(f'{name}: {rates[1]:.1f} frames/s, one loop {rates[0]:.1f}: {ratio:.2f} x '
          f'(at least {goal})', flush=True)
    return Figure('bags', f'img_convert, {name}: against one loop of OpenCV', ratio, 'x',
                  f'at least {goal}', ratio >= goal)


def _video_loop(video: Path, out: Path) -> None:
    capture = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG)
    number = 0
    while True:
        is_read, image = capture.read()
        if not is_read:
            break
        cv2.imwrite(str(out / f'{number:06d}.png'), image)
        number += 1


def _jpeg_loop(bag: Path, out: Path) -> None:
    """Write the JPEGs as files for ``imread``, which a loop of OpenCV needs, and convert them."""
    for number, path in enumerate(sorted((bag.parent / 'jpegs').iterdir())):
        cv2.imwrite(str(out / f'{number:06d}.jpg'), cv2.imread(str(path)))


def _write_sources(video: Path, bag: Path) -> None:
    """Write the clip in 1080p as H.264, as JPEG files, and as a bag of the same JPEGs."""
    capture = cv2.VideoCapture(str(CLIP), cv2.CAP_FFMPEG)
    jpegs = video.parent / 'jpegs'
    jpegs.mkdir()
    writer = BagWriter(bag)
    with av.open(str(video), 'w') as container:
        stream = container.add_stream('libx264', 25)
        stream.width, stream.height, stream.pix_fmt = *SIZE, 'yuv420p'
        for number in range(FRAMES):
            image = cv2.resize(capture.read()[1], SIZE, interpolation=cv2.INTER_CUBIC)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format='bgr24')))
            jpeg = cv2.imencode('.jpg', image)[1].tobytes()
            (jpegs / f'{number:06d}.jpg').write_bytes(jpeg)
            header = WireHeader(number // 25, number % 25 * 40_000_000, 'camera')
            message = WireCompressedImage(header=header, format='jpeg', data=jpeg)
            writer.write(
                BagChannel(topic=TOPIC, type_name=COMPRESSED_IMAGE),
                [compressed_image_to_cdr(message)], log_ns=number * 40_000_000,
                publish_ns=number * 40_000_000)
        container.mux(stream.encode(None))
    writer.close()
