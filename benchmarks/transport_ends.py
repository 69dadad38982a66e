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
The processes that benchmarks/transport.py compares: publishers, nodes with a filter, subscribers.

Both publishers send the same frames, which exist already, and stamp each frame when they have it
in hand. All subscribers have the frame as an array when they record its age. A process prints
`ready` or `done` when its frames arrive or were sent, and what it has measured at the end.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from itertools import pairwise
import json
import signal
import sys
import tempfile
from threading import Thread
import time
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from opencv_tools.base.units import NANO
from opencv_tools.basic_image_publisher import ImagePublisher
from opencv_tools.basic_image_subscriber import ImageSubscriber
from opencv_tools.frames import Frame, FrameNode, main as run_frame_node
from opencv_tools.nodes.executable import Executable
from opencv_tools.nodes.publisher import loop
from opencv_tools.nodes.run_node import EXIT_USAGE, run
from opencv_tools.recording.frames import RawFrame, ReceivedFrame
from opencv_tools.topics.message_reader import ImageReader
from std_msgs.msg import Header
from transport_parts import Ages, Camera, Flip, FRAMES, listen, Load, RESULTS
import transport_tutorial

LONGEST_WAIT = 0.1  # for a frame, in seconds
STAGES = ('frame in hand to middleware', "to the subscriber's history", 'executor wakes up',
          'message is taken', 'message to array')


class Stages:
    """Where the age of a frame comes from: nanoseconds from stage to stage."""

    def __init__(self) -> None:
        """Watch how messages are taken."""
        self.times: list[list[int]] = []
        self._taken: tuple[int, ...] = ()
        self._take = ImageReader.take
        ImageReader.take = lambda reader: self._watch(reader)

    def note(self, stamp_ns: int) -> None:
        """Record the age of the last received frame."""
        moments = (stamp_ns, *self._taken, time.time_ns())
        self.times.append([later - earlier for earlier, later in pairwise(moments)])

    def _watch(self, reader: ImageReader) -> Any:
        begin = time.time_ns()
        taken = self._take(reader)
        if taken:
            info = taken[-1][1]
            self._taken = (info.source_timestamp, info.received_timestamp, begin, time.time_ns())
        return taken


class OurSubscriber(ImageSubscriber):
    """The package's subscriber, which records the ages of frames instead of the frames."""

    ages: Ages
    stages: Stages

    def __init__(self) -> None:
        """Replace the recording of frames."""
        super().__init__()
        self._session.record = self._note

    def _note(self, frame: ReceivedFrame) -> None:
        assert isinstance(frame, RawFrame)
        if self.ages.note(frame.image, frame.metadata.stamp_ns):
            self.stages.note(frame.metadata.stamp_ns)


def publish(load: Load, *, encoding: str = 'bgr8') -> None:
    """Run img_publisher, with a camera that costs nothing."""
    camera = Camera(load, encoding)
    loop.open_source = lambda *_: camera
    executable = Executable(
        name='img_publisher', node='image_publisher', priority=load.priority,
        frame_bytes=load.frame_bytes)
    listen(camera.begin, _interrupt)
    run(executable, ImagePublisher, [
        'img_publisher', *load.arguments, '-p', 'publish_rate:=0.0'], failures=())
    camera.meter.report()


def subscribe(load: Load) -> None:
    """Run img_subscriber."""
    ages, stages = OurSubscriber.ages, OurSubscriber.stages = Ages(), Stages()
    executable = Executable(
        name='img_subscriber', node='image_subscriber', priority=load.priority)
    listen(lambda: None, _interrupt)
    with tempfile.TemporaryDirectory() as folder:
        status = run(executable, lambda _: OurSubscriber(), [
            'img_subscriber', *load.arguments, '-r', f'{FRAMES}:={load.topic}',
            '-p', f'output_dir:={folder}', '-p', f'transport:={load.transport}'], failures=())
    if status == EXIT_USAGE:
        raise SystemExit(status)
    ages.report(stages=stages.times)


def subscribe_in_thread(load: Load) -> None:
    """Run a node of opencv_tools.frames that receives each frame in a thread of its own."""
    ages = Ages()

    def create_node() -> FrameNode:
        node = FrameNode('receiving')
        node.receive_frames(
            load.topic, lambda frame: ages.note(frame.image, frame.stamp_ns), encoding='',
            every=True, threaded=True, transport=load.transport)
        return node

    _run_frame_node(create_node, load)
    ages.report()


class LoanPublisher(FrameNode):
    """A node of opencv_tools.frames that fills loaned frames with those of a camera."""

    def __init__(self, load: Load, camera: Camera) -> None:
        """Start the thread that publishes."""
        super().__init__('image_publisher')
        self._load, self._camera = load, camera
        self._frames = self.publish_frames(FRAMES)
        self._is_closed = False
        self._thread = Thread(target=self._publish_all)
        self._thread.start()

    def close(self) -> int:
        """End the thread and print what was measured."""
        self._is_closed = True
        self._thread.join()
        self._camera.meter.report()
        return super().close()

    def _publish_all(self) -> None:
        while not self._is_closed:
            if self._camera.wait(LONGEST_WAIT) and self._frames.has_subscribers:
                self._publish()

    def _publish(self) -> None:
        image = self._camera.read().image
        with self._frames.loan(self._load.height, self._load.width) as loan:
            with self._camera.meter.leave_out():
                np.copyto(loan.image, image)
            sec, nanosec = divmod(time.time_ns(), NANO)
            loan.source = Header(stamp=Time(sec=sec, nanosec=nanosec))


def publish_loans(load: Load) -> None:
    """Run a node of opencv_tools.frames that publishes loaned frames."""
    camera = Camera(load)
    _run_frame_node(lambda: LoanPublisher(load, camera), load, camera.begin)


def flip(load: Load, *, is_loaned: bool = False) -> None:
    """Run a node of opencv_tools.frames that receives, flips and publishes frames."""
    flip_image = Flip()

    def create_node() -> FrameNode:
        node = FrameNode('flipping')
        results = node.publish_frames(RESULTS)

        def flip_frame(frame: Frame) -> None:
            results.publish(flip_image(frame.image), frame)

        def flip_into_loan(frame: Frame) -> None:
            with results.loan(load.height, load.width, 'bgr8', frame) as loan:
                flip_image(frame.image, loan.image)

        node.receive_frames(FRAMES, flip_into_loan if is_loaned else flip_frame,
                            transport=load.transport)
        return node

    _run_frame_node(create_node, load)
    flip_image.report()


def _run_frame_node(
    create_node: Callable[[], FrameNode], load: Load, begin: Callable[[], object] = lambda: None,
) -> None:
    listen(begin, _interrupt)
    run_frame_node(create_node, ['node', *load.arguments], frame_size=(load.width, load.height),
                   priority=load.priority)


def _interrupt() -> None:
    signal.raise_signal(signal.SIGINT)


def _run_iceoryx2(load: Load, *, name: str) -> None:
    import transport_iceoryx2  # iceoryx2 is optional
    getattr(transport_iceoryx2, name)(load)


ENDS: dict[str, Callable[[Load], None]] = {
    'img_publisher': publish, 'yuyv publisher': partial(publish, encoding='yuv422_yuy2'),
    'img_subscriber': subscribe, 'thread': subscribe_in_thread, 'loan publisher': publish_loans,
    'own node': flip,
    'own node loan': partial(flip, is_loaned=True),
    'iceoryx2 publisher': partial(_run_iceoryx2, name='publish'),
    'iceoryx2 subscriber': partial(_run_iceoryx2, name='subscribe'),
    'tutorial publisher': transport_tutorial.publish,
    'tutorial subscriber': transport_tutorial.subscribe, 'plain node': transport_tutorial.flip}


def command(end: str, load: Load) -> list[str]:
    """Return the command line of a process."""
    return [sys.executable, __file__, end, json.dumps(asdict(load))]


def main() -> None:
    """Run one process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('end', choices=tuple(ENDS))
    parser.add_argument('load', help='frames to send, as JSON')
    options = parser.parse_args()
    ENDS[options.end](Load(**json.loads(options.load)))


if __name__ == '__main__':
    main()
