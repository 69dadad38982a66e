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

"""Receive frames until SIGINT or SIGTERM, then print what each node got as JSON."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import json
import signal
from threading import Event, Thread
from typing import Any
import zlib

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

TOPIC = 'video_frames'
IDLE_SPINS = 20  # without a frame; then the middleware has none that was confirmed
SIGNALS = (signal.SIGINT, signal.SIGTERM)
Subscribe = Callable[[Node, Callable[[Any], None]], Any]


class Receiver(Thread):
    """A node with a context of its own, so that to the middleware it is another process."""

    def __init__(self, subscribe: Subscribe, ended: Event) -> None:
        super().__init__()
        self.checksums: list[int] = []
        self._ended = ended
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node('frame_counter', context=self._context)
        self._subscription = subscribe(self._node, self._take)

    @property
    def lost(self) -> int | None:
        """Return how many frames the subscription counts as lost, None where it counts none."""
        return getattr(self._subscription, 'lost', None)

    def run(self) -> None:
        """Receive until the end, and then what the middleware has received."""
        executor = SingleThreadedExecutor(context=self._context)
        executor.add_node(self._node)
        while not self._ended.is_set():
            executor.spin_once(timeout_sec=0.1)
        idle = 0
        while idle < IDLE_SPINS:
            before = len(self.checksums)
            executor.spin_once(timeout_sec=0.02)
            idle = idle + 1 if len(self.checksums) == before else 0
        executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def _take(self, message: Any) -> None:
        if not self.checksums:
            print('the first frame', flush=True)
        print(f'a frame of {memoryview(message.data).nbytes} bytes', flush=True)
        self.checksums.append(zlib.crc32(message.data))


@contextmanager
def plain(best_effort: bool) -> Iterator[Subscribe]:
    """Subscribe as the tutorials of ROS do, with nothing of the package."""
    qos = QoSProfile(depth=10)
    if best_effort:
        qos.reliability = ReliabilityPolicy.BEST_EFFORT
    yield lambda node, take: node.create_subscription(Image, TOPIC, take, qos)


@contextmanager
def ours(_: bool) -> Iterator[Subscribe]:
    """Subscribe as img_subscriber does."""
    # Not at the top, so that a plain process has nothing of the package.
    from opencv_tools.base.logs import Log
    from opencv_tools.topics.options import SubscriptionOptions
    from opencv_tools.topics.subscription import FrameSubscription
    from opencv_tools.transport.fastdds.profile import configured_fastdds

    def _refuse(err: Exception) -> None:
        raise err

    def _subscribe(node: Node, take: Callable[[object], object]) -> FrameSubscription:
        subscription = FrameSubscription(
            node, TOPIC, Log(node.get_logger()), lambda received: take(received.message), _refuse,
            SubscriptionOptions(transport='raw', depth=None))
        subscription.start()
        return subscription

    with configured_fastdds(0):
        yield _subscribe


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('kind', choices=('plain', 'ours'))
    parser.add_argument('--nodes', type=int, default=1)
    parser.add_argument('--best-effort', action='store_true')
    arguments = parser.parse_args()
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    ended = Event()
    with {'plain': plain, 'ours': ours}[arguments.kind](arguments.best_effort) as subscribe:
        receivers = [Receiver(subscribe, ended) for _ in range(arguments.nodes)]
    for receiver in receivers:
        receiver.start()
    signal.sigwait(SIGNALS)
    ended.set()
    for receiver in receivers:
        receiver.join()
    print(json.dumps([(receiver.checksums, receiver.lost) for receiver in receivers]))


if __name__ == '__main__':
    main()
