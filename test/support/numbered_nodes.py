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
A publisher of numbered pictures in a process of its own, and a receiver that checks them.

Each writes a journal, which survives SIGKILL. A line has the time and words.
"""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
from queue import SimpleQueue
import signal
import sys
from threading import Thread
import time
import uuid

from numbered_pictures import number_of, picture
from opencv_tools.frames import Frame, FrameNode, FramePublisher, main
from opencv_tools.transport.shared_frames.pages import SharedMemoryError
from opencv_tools.transport.shared_frames.publisher import SharedFramePublisher
from opencv_tools.video.settings import VideoSettings
from pair_cases import LOSSY, OWN_TOPICS
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from waiting import pause

TOPIC = 'video_frames'
RATE = 30.0  # Hz
TICK_SECONDS = 0.1
SLOW_SECONDS = 0.3  # of a callback that is slower than the camera
#: Steps of the timer for each frame.
PACES = {'greet': 8, 'go': 1, 'pause': 0}
#: Names of the nodes that receive.
RECEIVERS = ('receiver', 'image_subscriber')
_LARGEST = (800, 600)


class Journal:
    """Lines of a process, each written at once."""

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def write(self, *words: object) -> None:
        """Write a line."""
        line = ' '.join(map(str, (time.monotonic(), *words)))
        os.write(self._file, f'{line}\n'.encode())


def offer(publisher: FramePublisher, service: str) -> None:
    """
    Change the offer of frames in shared memory.

    :param publisher: the publisher.
    :param service: ``share`` for its own service, ``withdraw`` for none, as if /dev/shm were full,
        or ``mislead`` for one that nobody can open.
    """
    shared = publisher._topics.shared
    if service == 'share':
        vars(shared).pop('_announce', None)
        shared._is_announced = False
        shared._next_check = 0.0
    elif service == 'withdraw':
        shared._withdraw(SharedMemoryError('withdrawn by the test'))
        shared._next_check = float('inf')
    else:
        shared._announce = lambda _: SharedFramePublisher._announce(shared, uuid.uuid4().hex)
        shared._announce('')


class NumberedPublisher(FrameNode):
    """
    Publish pictures of 1, 2, ... as the lines of the standard input say.

    The orders are the names of ``PACES``, the offers of `offer`, ``end``, and ``die``.
    """

    def __init__(self, life: str, journal: str, scale: str, image: str, neighbour: str) -> None:
        """
        Create the publishers.

        :param life: name of this publisher, the ``frame_id`` of its frames.
        :param journal: file for a line before each frame: number, pace, and number of
            subscriptions of the image topic by ``RECEIVERS``.
        :param scale: scale of the pictures.
        :param image: ``loan`` to fill loaned images, ``array`` to publish arrays.
        :param neighbour: transport of a receiver in this node, so that frames are published before
            another one comes; '' for none.
        """
        super().__init__(f'publisher_{life}')
        self._life, self._journal, self._scale = life, Journal(journal), int(scale)
        self._is_loaned = image == 'loan'
        self._frames = self.publish_frames(TOPIC, video=VideoSettings())
        self._infos = self.create_publisher(CameraInfo, 'camera_info', 10)
        if neighbour:
            self.receive_frames(TOPIC, lambda _: None, transport=neighbour)
        self._orders: SimpleQueue[str] = SimpleQueue()
        self._pace = 'greet'
        self._number = self._steps = 0
        Thread(target=self._listen, daemon=True).start()
        self.create_timer(1 / RATE, self._step)

    def _listen(self) -> None:
        for line in sys.stdin:
            self._orders.put(line.strip())
        self._orders.put('end')

    def _step(self) -> None:
        while not self._orders.empty():
            self._follow(self._orders.get())
        self._steps += 1
        pace = PACES[self._pace]
        if pace and self._steps % pace == 0 and self._frames.has_subscribers:
            self._publish()

    def _follow(self, order: str) -> None:
        if order == 'end':
            self._pace = 'pause'
            if not self.done.done():
                self.done.set_result(0)
        elif order == 'die':
            # Here it holds no mutex of Fast DDS. A process that is killed with the mutex of a port
            # crashes the process of the port when that ends in the same second (Fast DDS 2.14).
            os.kill(os.getpid(), signal.SIGKILL)
        elif order in PACES:
            self._pace = order
        else:
            offer(self._frames, order)
        self._journal.write(order)

    def _publish(self) -> None:
        self._number += 1
        subscriptions = sum(info.node_name in RECEIVERS
                            for info in self.get_subscriptions_info_by_topic(TOPIC))
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self._life)
        self._journal.write('frame', self._number, self._pace, subscriptions)
        pixels = picture(self._number, self._scale)
        if self._is_loaned:
            with self._frames.loan(*pixels.shape[:2], source=header) as loan:
                loan.image = pixels
        else:
            self._frames.publish(pixels, header)
        self._infos.publish(CameraInfo(header=header))


class CheckingReceiver(FrameNode):
    """Write the number of each frame and the ticks of a timer into a journal."""

    def __init__(self, journal: str, way: str, frames: str, consumer: str, camera_info: str,
                 callback: str) -> None:
        """
        Subscribe. The words are values of the factors of the same names in `pair_cases`.

        :param journal: file of the journal. While there is a file ``<journal>.hold``, the
            callback does not return.
        """
        super().__init__(RECEIVERS[0])
        self._journal, self._hold = Journal(journal), Path(f'{journal}.hold')
        self._is_exact = way not in LOSSY
        self._has_info = camera_info == 'with'
        self._callback = callback
        self.create_timer(TICK_SECONDS, lambda: self._journal.write('tick'))
        self._frames = self.receive_frames(
            TOPIC, self._on_frame, every=frames == 'every', threaded=consumer == 'threaded',
            camera_info=self._has_info,
            transport=way if way in OWN_TOPICS else 'auto')

    def _on_frame(self, frame: Frame) -> None:
        number = number_of(frame.image, is_exact=self._is_exact)
        self._journal.write('call', frame.frame_id, number)
        info = frame.camera_info
        if (info.header if info else None) != (frame.header if self._has_info else None):
            self._journal.write('wrong', info)
        if self._hold.exists():
            self._journal.write('held')
            while self._hold.exists():
                pause(0.01)
            if self._callback == 'raising':
                raise RuntimeError('of the callback')
        if self._callback == 'slow':
            pause(SLOW_SECONDS)
        self._journal.write('done')

    def close(self) -> int:
        """Unsubscribe, and write the counts."""
        self._journal.write('closing')
        try:
            return super().close()
        finally:
            self._journal.write('closed', self._frames.skipped, self._frames.failed)


def run(kind: Callable[..., FrameNode], *arguments: str) -> int:
    """Run a node with the words of the command line."""
    return main(lambda: kind(*arguments), sys.argv[:1], frame_size=_LARGEST)


if __name__ == '__main__':
    sys.exit(run({'publisher': NumberedPublisher, 'receiver': CheckingReceiver}[sys.argv[1]],
                 *sys.argv[2:]))
