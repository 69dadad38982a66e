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

"""
Video topics against JPEG: bytes, similarity, age, processor time, wait of a late subscriber.

The bit rates are those of the messages that a subscriber in another process receives.

The frames are those of the shipped clip, 1280x720, as they are and with noise of a camera. The age
of a frame is the time from when its publisher has it in hand to when a subscriber in another
process has it as an array. The ways run in turn.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
import os
from pathlib import Path
import resource
import statistics
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any

import av
from builtin_interfaces.msg import Time
import cv2
from figures import add_json_option, Figure, print_figures
from node_process import enter_domain, NodeProcess
import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.units import NANO
from opencv_tools.frames import Frame, FrameNode, FrameSubscriber, main as run_node
from opencv_tools.transport.message_type import message_type
from opencv_tools.video.decoder import VideoDecoder
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.messages import cdr_to_video, FFMPEG_PACKET
from opencv_tools.video.settings import VideoSettings
import rclpy
from std_msgs.msg import Header

CLIP = Path(__file__).resolve().parent.parent / 'test/data/big_buck_bunny_720p.mp4'
TOPIC = 'measured'
RATE = 30.0
NOISE = 4.0  # standard deviation, as of a camera in a room
JPEG_QUALITY = 95
SETTLED_SECONDS = 2.5  # a subscriber's second key frame, and the second without others after it
WAYS = ('raw', 'compressed', 'video')
FEWER_BYTES, LEAST_SSIM = 20.0, 0.95  # goals
P50_MS, P99_MS, FIRST_MS, CPU_PER_CENT = 20.0, 33.0, 100.0, 40.0
RATES, BIT_RATES = (5.0, 10.0, 30.0, 60.0, 120.0), (100_000, 500_000, 2_000_000)
PART = 240, 320  # pixels of the frames, so that a core can encode all rates
WITHIN = 0.15  # of the promised bit rate
RECORDING_CPU = {'mkv': 0.1, 'mcap': 0.12}  # of the processor time of writing JPEGs
RECORDINGS: dict[str, dict[str, object]] = {  # parameters of img_subscriber
    'jpg': {'transport': 'video', 'file_name': '"{seq:06d}.jpg"'},
    'mkv': {'transport': 'video', 'file_name': 'drive.mkv'},
    'mcap': {'transport': 'video', 'file_name': 'drive.mcap'}}


Image = NDArray[np.uint8]


def clip(count: int, noise: float) -> Iterator[Image]:
    """Yield frames of the clip with added noise."""
    random = np.random.default_rng(1)
    with av.open(str(CLIP)) as container:
        for _, frame in zip(range(count), container.decode(video=0)):
            image = frame.to_ndarray(format='bgr24')
            yield np.clip(image + random.normal(0, noise, image.shape), 0, 255).astype(
                np.uint8) if noise else image


def ssim(first: Image, second: Image) -> float:
    """Return the mean structural similarity of two images in gray (Wang et al., 2004)."""
    x, y = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float64)
            for image in (first, second))

    def blur(image: NDArray[Any]) -> NDArray[Any]:
        return cv2.GaussianBlur(image, (11, 11), 1.5)

    mean_x, mean_y = blur(x), blur(y)
    variances = blur(x * x) - mean_x ** 2 + blur(y * y) - mean_y ** 2
    covariance = blur(x * y) - mean_x * mean_y
    small, large = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    found = ((2 * mean_x * mean_y + small) * (2 * covariance + large)
             / ((mean_x ** 2 + mean_y ** 2 + small) * (variances + large)))
    return float(found.mean())


def sizes() -> Iterator[Figure]:
    """Compare the bytes of H.264 with those of JPEG."""
    for name, noise in (('clip', 0.0), ('clip with noise', NOISE)):
        encoder, decoder = VideoEncoder(VideoSettings(), 1280, 720, RATE), VideoDecoder('h264')
        jpeg, video, alike = [], [], []
        for number, (image, clean) in enumerate(zip(clip(90, noise), clip(90, 0.0))):
            jpeg.append(len(cv2.imencode(
                '.jpg', image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1]))
            packet = encoder.encode(image, 'bgr8', round(number * NANO / RATE))
            video.append(len(packet.data))
            alike.append(ssim(decoder.decode(packet.data), clean))
        ratio, similar = sum(jpeg) / sum(video), statistics.mean(alike)
        yield Figure('video', f'{name}: bytes of JPEG {JPEG_QUALITY} to those of H.264', ratio,
                     'x', f'at least {FEWER_BYTES:g}', ratio >= FEWER_BYTES)
        yield Figure('video', f'{name}: similarity of H.264 to the frames of the clip', similar,
                     'SSIM', f'at least {LEAST_SSIM}', similar >= LEAST_SSIM)


class Camera(FrameNode):
    """Publish frames with noise, whose number is not known before."""

    def __init__(self, bit_rate: int = 0, rate: float = RATE,
                 part: tuple[int, int] = (720, 1280)) -> None:
        """
        Read the frames.

        :param bit_rate: bits per second of the video; 0 for a constant quality.
        :param rate: frames per second.
        :param part: height and width of the part of the clip that is published, in pixels.
        """
        super().__init__('camera')
        self._images = [image[:part[0], :part[1]] for image in clip(60, NOISE)]
        self._number = 0
        self._frames = self.publish_frames(TOPIC, quality=JPEG_QUALITY, video=VideoSettings(
            bit_rate=bit_rate))
        self.create_timer(1 / rate, self._publish)
        self.create_timer(0.5, self._report)

    def _publish(self) -> None:
        # There and back, so that no frame differs much from the one before.
        place = self._number % (2 * len(self._images) - 2)
        image = self._images[min(place, 2 * len(self._images) - 2 - place)]
        self._number += 1
        sec, nanosec = divmod(time.time_ns(), NANO)
        self._frames.publish(image, Header(stamp=Time(sec=sec, nanosec=nanosec)))

    def _report(self) -> None:
        used = resource.getrusage(resource.RUSAGE_SELF)
        print(self._number, used.ru_utime + used.ru_stime, flush=True)


@dataclass
class Run:
    """Ages of frames in ms, per cent of a core of the publisher, and ms to the first frame."""

    ages: list[float]
    cpu: float
    first: float


def receive(transport: str, seconds: float) -> Run:
    """Receive the frames of a publisher that has another subscriber already."""
    with subprocess.Popen([sys.executable, __file__, 'camera'], stdout=subprocess.PIPE,
                          text=True) as camera:
        assert camera.stdout
        try:
            rclpy.init()
            node = rclpy.create_node('receiver')
            ages: list[float] = []

            def note(frame: Frame) -> None:
                ages.append((time.time_ns() - frame.stamp_ns) / 1e6)

            def spin(until: float) -> None:
                while time.monotonic() < until:
                    rclpy.spin_once(node, timeout_sec=0.05)

            other = FrameSubscriber(node, TOPIC, lambda _: None, transport=transport)
            camera.stdout.readline()
            spin(time.monotonic() + SETTLED_SECONDS)
            began = time.monotonic()
            late = FrameSubscriber(node, TOPIC, note, every=True, transport=transport)
            while not ages:
                rclpy.spin_once(node, timeout_sec=0.05)
            first = (time.monotonic() - began) * 1e3
            other.destroy()
            spin(time.monotonic() + SETTLED_SECONDS)
            os.set_blocking(camera.stdout.fileno(), False)
            ages.clear()
            camera.stdout.read()
            spin(time.monotonic() + seconds)
            lines = [line.split() for line in (camera.stdout.read() or '').splitlines()]
            late.destroy()
            node.destroy_node()
            rclpy.shutdown()
        finally:
            camera.terminate()
    cpu = (float(lines[-1][1]) - float(lines[0][1])) / ((len(lines) - 1) * 0.5)
    return Run(ages, cpu * 100, first)


def receive_bits(bit_rate: int, rate: float, seconds: float) -> float:
    """Return the bits per second of the messages that a subscriber receives."""
    found: list[tuple[int, int]] = []  # time and bits

    def note(message: bytes) -> None:
        found.append((time.monotonic_ns(), 8 * len(cdr_to_video(FFMPEG_PACKET, message).data)))

    options = {'rate': [rate], 'bits': [bit_rate], 'part': PART}
    command = [sys.executable, __file__, 'camera', *(
        f'{word}' for name, given in options.items() for word in (f'--{name}', *given))]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as camera:
        try:
            rclpy.init()
            node = rclpy.create_node('receiver')
            node.create_subscription(
                message_type(FFMPEG_PACKET), f'{TOPIC}/ffmpeg', note, 1000, raw=True)
            while not found or found[-1][0] < found[0][0] + (SETTLED_SECONDS + seconds) * NANO:
                rclpy.spin_once(node, timeout_sec=0.05)
            node.destroy_node()
            rclpy.shutdown()
        finally:
            camera.terminate()
    # The rate of the frames is measured at first.
    found = [one for one in found if one[0] > found[0][0] + SETTLED_SECONDS * NANO]
    return sum(bits for _, bits in found[1:]) / (found[-1][0] - found[0][0]) * NANO


def bit_rates(seconds: float) -> Iterator[Figure]:
    """Compare the bits that a subscriber receives with those that were promised."""
    for rate in RATES:
        for bit_rate in BIT_RATES:
            ratio = receive_bits(bit_rate, rate, max(seconds, 5 / rate)) / bit_rate
            yield Figure('video', f'{rate:g} Hz: received bits to {bit_rate / 1e6:g} Mbit/s',
                         ratio, 'x', f'within {WITHIN:.0%}', abs(ratio - 1) <= WITHIN)


def topics(runs: int, seconds: float) -> Iterator[Figure]:
    """Compare video with JPEG and raw images between two processes."""
    found: dict[str, list[Run]] = {way: [] for way in WAYS}
    for _ in range(runs):
        for way in WAYS:
            found[way].append(receive(way, seconds))
    for way, measured in found.items():
        p50 = statistics.median(np.percentile(run.ages, 50) for run in measured)
        p99 = statistics.median(np.percentile(run.ages, 99) for run in measured)
        first = statistics.median(run.first for run in measured)
        cpu = statistics.median(run.cpu for run in measured)
        for name, value, unit, goal in (
                ('age p50', p50, 'ms', P50_MS), ('age p99', p99, 'ms', P99_MS),
                ('first frame of a late subscriber', first, 'ms', FIRST_MS),
                ('publisher, of a core', cpu, '%', CPU_PER_CENT)):
            has_goal = way == 'video'
            yield Figure('video', f'720p30 {way}: {name}', float(value), unit,
                         f'at most {goal:g}' if has_goal else '',
                         bool(value <= goal) if has_goal else None)


def record(source: Path, form: str, seconds: float) -> float:
    """Return the processor time of a node that records a video topic, in per cent of a core."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        nodes = [NodeProcess('publisher', folder, source=source, loop=0, publish_rate=0.0)]
        try:
            nodes.append(NodeProcess(
                'subscriber', folder, output_dir=folder / 'recorded', **RECORDINGS[form]))
            nodes[1].wait_for('Receiving video frame')
            time.sleep(SETTLED_SECONDS)
            before = nodes[1].cpu()
            time.sleep(seconds)
            return (nodes[1].cpu() - before) / seconds * 100
        finally:
            for node in reversed(nodes):
                node.end()


def recordings(runs: int, seconds: float) -> Iterator[Figure]:
    """Compare the recording of unchanged packets with decoding them and writing JPEGs."""
    with TemporaryDirectory() as name:
        noisy = Path(name) / 'noisy.avi'
        writer = cv2.VideoWriter(str(noisy), cv2.VideoWriter.fourcc(*'MJPG'), RATE, (1280, 720))
        for image in clip(90, NOISE):
            writer.write(image)
        writer.release()
        for clip_name, source in (('clip', CLIP), ('clip with noise', noisy)):
            found = {form: statistics.median(record(source, form, seconds) for _ in range(runs))
                     for form in RECORDINGS}
            for form, used in found.items():
                yield Figure('video', f'{clip_name}: video recorded into {form}, of a core', used,
                             '%')
                if form != 'jpg':
                    ratio = used / found['jpg']
                    yield Figure('video', f'{clip_name}: the same to JPEGs', ratio, 'x',
                                 f'at most {RECORDING_CPU[form]:g}',
                                 ratio <= RECORDING_CPU[form])


def main() -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('end', nargs='?', choices=('camera',), help=argparse.SUPPRESS)
    parser.add_argument('--rate', type=float, default=RATE, help=argparse.SUPPRESS)
    parser.add_argument('--bits', type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument('--part', type=int, nargs=2, default=(720, 1280), help=argparse.SUPPRESS)
    parser.add_argument('--runs', type=int, default=3, help='runs to take the median of')
    parser.add_argument('--seconds', type=float, default=6.0, help='duration of a run')
    add_json_option(parser)
    options = parser.parse_args()
    enter_domain()
    if options.end:
        return run_node(
            lambda: Camera(options.bits, options.rate, tuple(options.part)), sys.argv[:1])
    print_figures(chain(sizes(), bit_rates(options.seconds), topics(options.runs, options.seconds),
                        recordings(options.runs, options.seconds)), options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
