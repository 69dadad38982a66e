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
The processes that benchmarks/transport.py compares: publisher and subscriber of two ways.

Both publishers send the same frames, which are there already, and stamp each when they have it in
hand. Both subscribers hold it as an array and note how old it is. Each process prints what it
found as JSON.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import pairwise
import json
from pathlib import Path
import resource
import signal
import sys
import tempfile
from threading import Thread
import time
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from opencv_tools.basic_image_publisher import ImagePublisher
from opencv_tools.basic_image_subscriber import ImageSubscriber
from opencv_tools.capture.frame import Frame
from opencv_tools.recording.frames import RawFrame, ReceivedFrame
from opencv_tools.recording.naming import NANO
from opencv_tools.ros.publisher import loop, parameters as publisher_parameters
from opencv_tools.ros.run_node import Executable, run
from opencv_tools.ros.subscriber import parameters as subscriber_parameters
from opencv_tools.ros.subscriber.raw_subscription import RawSubscription
import rclpy
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

TOPIC = 'video_frames'
SETTLED_FRAMES = 500  # after which memory should not grow
_SETTLE_SECONDS = 0.3  # from the first sight of a subscriber to the first frame
_PAGE = resource.getpagesize()


@dataclass(frozen=True)
class Load:
    """
    What is sent.

    :param width: pixels a row.
    :param height: rows.
    :param rate: frames per second.
    :param frames: how many.
    :param qos: ``reliable`` or ``best_effort``.
    :param namespace: of the nodes.
    """

    width: int
    height: int
    rate: float
    frames: int
    qos: str
    namespace: str

    @property
    def frame_bytes(self) -> int:
        """Size of a colour frame in bytes."""
        return self.width * self.height * 3

    @property
    def arguments(self) -> list[str]:
        """Command line arguments of a node."""
        return ['--ros-args', '-r', f'__ns:={self.namespace}']


class Meter:
    """What a process spends from its first frame on, and the memory it holds."""

    def __init__(self) -> None:
        """Begin with the first frame."""
        self.frames = 0
        self._settled_rss = 0.0
        self._cpu = 0.0
        self._faults = 0

    def tick(self) -> None:
        """Count a frame; the first is not charged."""
        if not self.frames:
            self._cpu = time.process_time()
            self._faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        self.frames += 1
        if self.frames == SETTLED_FRAMES:
            self._settled_rss = _resident_mb()

    def report(self, **more: object) -> None:
        """Print what was found."""
        charged = max(1, self.frames - 1)
        faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - self._faults
        growth = _resident_mb() - self._settled_rss if self._settled_rss else 0.0
        print(json.dumps({
            'frames': self.frames, 'cpu': (time.process_time() - self._cpu) / charged * 1e3,
            'faults': faults / charged, 'growth': growth, **more}), flush=True)


class Camera:
    """A camera that costs nothing: two frames that are there already, in turn and numbered."""

    live: Literal[True] = True
    missed = 0
    name = 'a camera'
    description = 'bgr8'

    def __init__(self, load: Load) -> None:
        """Create the frames."""
        self.rate = load.rate
        self.meter = Meter()
        random = np.random.default_rng(1)
        self._images = [random.integers(0, 256, (load.height, load.width, 3), np.uint8)
                        for _ in range(2)]
        self._due = time.monotonic()

    def wait(self, seconds: float) -> bool:
        """Wait until a frame is due."""
        left = self._due - time.monotonic()
        time.sleep(max(0.0, min(left, seconds)))
        return left <= seconds

    def skip(self) -> None:
        """Pass over a frame."""
        self._due += 1 / self.rate

    def read(self) -> Frame:
        """Return the next frame."""
        self.skip()
        number = self.meter.frames
        self.meter.tick()
        image = self._images[number % 2]
        _number_of(image)[0] = number
        return Frame(image, 'bgr8', time.monotonic_ns())

    def close(self) -> None:
        """Release nothing."""


class Ages:
    """The frames that came, and how old each was when it was an array."""

    def __init__(self) -> None:
        """Begin without any."""
        self._meter = Meter()
        self._numbers: set[int] = set()
        self._ages: list[int] = []

    def note(self, image: NDArray[Any], stamp_ns: int) -> None:
        """Record the age of a frame."""
        self._ages.append(time.time_ns() - stamp_ns)
        self._meter.tick()
        self._numbers.add(int(_number_of(image)[0]))

    def report(self, **more: object) -> None:
        """Print what was found."""
        self._meter.report(delivered=len(self._numbers), ages=self._ages, **more)


class Stages:
    """Where the age of a frame comes from: nanoseconds from stage to stage."""

    def __init__(self) -> None:
        """Watch how messages are taken."""
        self.times: list[list[int]] = []
        self._taken: tuple[int, ...] = ()
        self._take = RawSubscription.take_data
        RawSubscription.take_data = lambda subscription: self._watch(subscription)

    def note(self, stamp_ns: int) -> None:
        """Record the age of the last received frame."""
        moments = (stamp_ns, *self._taken, time.time_ns())
        self.times.append([later - earlier for earlier, later in pairwise(moments)])

    def _watch(self, subscription: RawSubscription) -> Any:
        begin = time.time_ns()
        taken = self._take(subscription)
        if taken:
            info = taken[-1][1]
            self._taken = (info.source_timestamp, info.received_timestamp, begin, time.time_ns())
        return taken


class OurSubscriber(ImageSubscriber):
    """The package's subscriber, which notes the age of frames instead of writing them."""

    ages: Ages
    stages: Stages

    def __init__(self) -> None:
        """Replace the recording of frames."""
        super().__init__()
        self._session.record = self._note

    def _note(self, frame: ReceivedFrame) -> None:
        assert isinstance(frame, RawFrame)
        self.ages.note(frame.image, frame.metadata.stamp_ns)
        self.stages.note(frame.metadata.stamp_ns)


class TutorialPublisher(Node):
    """The tutorial's publisher, which fills messages as upstream's cv_bridge does."""

    def __init__(self, load: Load) -> None:
        """Begin to publish when somebody subscribes."""
        super().__init__('image_publisher')
        self.camera = Camera(load)
        self._frames = load.frames
        self._begin = 0.0
        self.publisher_ = self.create_publisher(Image, TOPIC, _tutorials_qos(load))
        self.timer = self.create_timer(1 / load.rate, self.timer_callback)

    @property
    def is_done(self) -> bool:
        """Return whether all frames were published."""
        return self.camera.meter.frames == self._frames

    def timer_callback(self) -> None:
        """Publish a frame."""
        if not self._begin and self.publisher_.get_subscription_count():
            self._begin = time.monotonic() + _SETTLE_SECONDS
        if not self._begin or time.monotonic() < self._begin:
            return
        frame = self.camera.read().image
        sec, nanosec = divmod(time.time_ns(), NANO)
        message = Image(height=frame.shape[0], width=frame.shape[1], encoding='bgr8',
                        step=frame.shape[1] * 3)
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        message.data.frombytes(frame.tobytes())
        self.publisher_.publish(message)
        self.get_logger().info('Publishing video frame')


class TutorialSubscriber(Node):
    """The tutorial's subscriber, which notes the age of frames instead of showing them."""

    def __init__(self, load: Load) -> None:
        """Subscribe."""
        super().__init__('image_subscriber')
        self.ages = Ages()
        self.subscription = self.create_subscription(
            Image, TOPIC, self.listener_callback, _tutorials_qos(load))

    def listener_callback(self, data: Image) -> None:
        """Convert a frame like upstream's cv_bridge."""
        self.get_logger().info('Receiving video frame')
        frame = np.ndarray((data.height, data.width, 3), np.uint8, buffer=data.data)
        self.ages.note(frame, data.header.stamp.sec * NANO + data.header.stamp.nanosec)


def publish_ours(load: Load) -> int:
    """Run the package's publisher, with a camera that costs nothing."""
    camera = Camera(load)
    loop.open_source = lambda *_: camera
    executable = Executable(
        name='img_publisher', node='image_publisher', description='', example='',
        parameters=publisher_parameters.PARAMETERS, frame_bytes=lambda _: load.frame_bytes)
    topic = f'{load.namespace}/{TOPIC}'
    status = run(executable, ImagePublisher, [
        'img_publisher', *load.arguments, '-p', 'publish_rate:=0.0',
        '-p', f'max_frames:={load.frames}', '-p', 'wait_for_subscribers:=1',
        '-p', f'qos_overrides.{topic}.publisher.reliability:={load.qos}'], failures=())
    camera.meter.report()
    return status


def subscribe_ours(load: Load) -> int:
    """Run the package's subscriber."""
    ages, stages = OurSubscriber.ages, OurSubscriber.stages = Ages(), Stages()
    executable = Executable(
        name='img_subscriber', node='image_subscriber', description='', example='',
        parameters=subscriber_parameters.PARAMETERS)
    when_input_ends(lambda: signal.raise_signal(signal.SIGINT))
    with tempfile.TemporaryDirectory() as folder:
        status = run(executable, lambda _: OurSubscriber(), [
            'img_subscriber', *load.arguments, '-p', f'output_dir:={folder}'], failures=())
    ages.report(stages=stages.times)
    return status


def publish_tutorials(load: Load) -> int:
    """Run the tutorial's publisher."""
    rclpy.init(args=['tutorial', *load.arguments])
    node = TutorialPublisher(load)
    while not node.is_done:
        rclpy.spin_once(node)
    node.publisher_.wait_for_all_acked(Duration(seconds=5))
    node.camera.meter.report()
    return 0


def subscribe_tutorials(load: Load) -> int:
    """Run the tutorial's subscriber."""
    rclpy.init(args=['tutorial', *load.arguments])
    node = TutorialSubscriber(load)
    when_input_ends(rclpy.try_shutdown)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)
    node.ages.report()
    return 0


def when_input_ends(end: Callable[[], object]) -> None:
    """Call something when the process that started this one wants it to end."""
    def wait() -> None:
        sys.stdin.read()
        end()

    Thread(target=wait, daemon=True).start()


ENDS = {
    ('ours', 'publisher'): publish_ours, ('ours', 'subscriber'): subscribe_ours,
    ('tutorial', 'publisher'): publish_tutorials, ('tutorial', 'subscriber'): subscribe_tutorials}


def command(way: str, end: str, load: Load) -> list[str]:
    """Return the command line of a process."""
    return [sys.executable, __file__, way, end, json.dumps(asdict(load))]


def _tutorials_qos(load: Load) -> QoSProfile:
    """Return the tutorial's QoS profile with depth 10, reliable or best effort."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy[load.qos.upper()])


def _number_of(image: NDArray[Any]) -> NDArray[Any]:
    """Return a view of the first four bytes of a frame, its number."""
    return image.reshape(-1)[:4].view('<u4')


def _resident_mb() -> float:
    return int(Path('/proc/self/statm').read_text().split()[1]) * _PAGE / 1e6


def main() -> int:
    """Run one process of one way."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('way', choices=('ours', 'tutorial'))
    parser.add_argument('end', choices=('publisher', 'subscriber'))
    parser.add_argument('load', help='as JSON')
    options = parser.parse_args()
    return ENDS[options.way, options.end](Load(**json.loads(options.load)))


if __name__ == '__main__':
    raise SystemExit(main())
