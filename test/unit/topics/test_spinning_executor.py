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

"""Objects that are made and destroyed while an executor spins in another thread."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
import gc
from pathlib import Path
from threading import Event, Thread
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np
from opencv_tools.base.logs import Log
from opencv_tools.basic_image_subscriber import ImageSubscriber
from opencv_tools.frames import Frame, FrameNode, FramePublisher, FrameSubscriber
from opencv_tools.image_viewer import ImageViewer
from opencv_tools.nodes.run_node import ClosableNode
from opencv_tools.recording.recorder import FrameCounts
from opencv_tools.video.settings import VideoSettings
from opencv_tools.viewer.graph import Graph
from opencv_tools.viewer.recording.bag_recording import RecordedImages, Topic
from opencv_tools.viewer.streams.feed import Feed
import pytest
import rclpy
from rclpy.executors import Executor, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from waiting import LONGEST_SECONDS

TOPIC = 'video_frames'
#: How often an object is made. Each of the slow ones takes about 0.1 s.
TIMES = [40, pytest.param(300, marks=pytest.mark.thorough)]
SLOW = ('video', 'shared memory')
NODES = 10  # each takes about 0.1 s
IMAGE = np.zeros((4, 6), np.uint8)
EXECUTORS: dict[str, Callable[[], Executor]] = {
    'single thread': SingleThreadedExecutor, 'threads': partial(MultiThreadedExecutor, 4),
    'callback': partial(MultiThreadedExecutor, 4)}


class Destroyable(Protocol):
    """An object that was given to the executor."""

    def destroy(self) -> None:
        """Take it from the executor."""


class _Recorder:
    """Recording of the frames of the topic, as the viewer does it."""

    def __init__(self, node: Node) -> None:
        self.frames: list[object] = []
        session: Any = SimpleNamespace(
            record=self.frames.append, others=FrameCounts(),
            recorder=SimpleNamespace(has_room=True))
        self._images = RecordedImages(
            node, Topic(f'/{TOPIC}', 'auto'), Log(node.get_logger()), session, self.frames.append)

    def destroy(self) -> None:
        self._images.close()


class _Look:
    """A subscription of the viewer, for a page that looks at the topic."""

    def __init__(self, node: Node) -> None:
        self._graph = Graph(node, (), 'auto', Log(node.get_logger()), None)
        self._feed = Feed(lambda: None)
        self._graph.open((f'/{TOPIC}', 'auto'), self._feed)

    def destroy(self) -> None:
        self._graph.close((f'/{TOPIC}', 'auto'), self._feed)


class _Loans:
    """A publisher whose frames are lent."""

    def __init__(self, node: Node) -> None:
        self._publisher = FramePublisher(node, TOPIC)
        self._loan = self._publisher.loan(4, 6, 'mono8')

    def destroy(self) -> None:
        with self._loan as loan:
            loan.image[:] = 1
        self._publisher.destroy()


def subscribe(node: Node, **options: Any) -> FrameSubscriber:
    return FrameSubscriber(node, TOPIC, lambda _: None, **options)


MADE: dict[str, Callable[[Node], Destroyable]] = {
    'newest frame': partial(subscribe, transport='raw'),
    'shared memory': subscribe,
    'every frame': partial(subscribe, every=True, transport='raw'),
    'calibrations': partial(subscribe, camera_info=True, transport='raw'),
    'thread': partial(subscribe, threaded=True, transport='raw'),
    'publisher': lambda node: FramePublisher(node, TOPIC),
    'video': lambda node: FramePublisher(node, TOPIC, video=VideoSettings()),
    'loans': _Loans, 'recorder': _Recorder, 'viewer': _Look}


class Spinning:
    """An executor that spins in a thread, with a camera that publishes all the time."""

    def __init__(self, executor: Executor) -> None:
        self.executor = executor
        self.errors: list[BaseException] = []
        self.node = FrameNode('spinning')
        self._camera = self.node.publish_frames(TOPIC)
        self.node.create_timer(0.002, lambda: self._camera.publish(IMAGE))
        self.node.receive_frames(TOPIC, lambda _: None, transport='video')
        executor.add_node(self.node)
        self._ended = Future()
        self._thread = Thread(target=self._spin)
        self._thread.start()

    def check(self) -> None:
        """Check that the executor still runs callbacks."""
        is_run = Event()
        self.executor.create_task(is_run.set)
        is_run.wait(0.0 if self.errors else LONGEST_SECONDS)
        assert self.errors == []
        assert is_run.is_set()

    def close(self) -> None:
        self._ended.set_result(None)  # see `conftest.spinning`
        self._thread.join()
        self.executor.shutdown()
        self.node.close()
        self.node.destroy_node()

    def _spin(self) -> None:
        try:
            self.executor.spin_until_future_complete(self._ended)
        except BaseException as err:  # noqa: B902 - of any callback
            self.errors.append(err)


@pytest.fixture
def spin(domain: int, tmp_path: Path) -> Iterator[Callable[[Executor], Spinning]]:
    """Return a function that spins an executor until the test ends."""
    rclpy.init(domain_id=domain, args=[
        '--ros-args', '-p', f'output_dir:={tmp_path}', '-p', 'port:=0'])
    begun: list[Spinning] = []

    def _spin(executor: Executor) -> Spinning:
        begun.append(Spinning(executor))
        return begun[-1]

    yield _spin
    for spinning in begun:
        spinning.close()
    rclpy.shutdown()
    # rclpy prints the errors of tasks that nobody awaits when these are collected; not later, in
    # the output of another test.
    begun.clear()
    gc.collect(1)


@pytest.mark.parametrize('made', MADE)
@pytest.mark.parametrize('kind', EXECUTORS)
@pytest.mark.parametrize('times', TIMES)
def test_objects_beside_a_spinning_executor(
        spin: Callable[[Executor], Spinning], kind: str, made: str, times: int) -> None:
    spinning = spin(EXECUTORS[kind]())
    present: list[Destroyable] = []
    are_made = Event()
    remaining = times // 10 if made in SLOW else times

    def replace() -> None:
        nonlocal remaining
        if present:
            present.pop().destroy()
        if remaining:
            remaining -= 1
            present.append(MADE[made](spinning.node))
        else:
            timer.cancel()
            are_made.set()

    timer = spinning.node.create_timer(0.001, replace, autostart=kind == 'callback')
    if kind == 'callback':
        while not (spinning.errors or are_made.wait(0.01)):
            pass
    else:
        while not (spinning.errors or are_made.is_set()):
            replace()
    assert (spinning.errors, remaining, present) == ([], 0, [])
    spinning.check()


@pytest.mark.parametrize('create', [ImageSubscriber, ImageViewer])
@pytest.mark.parametrize('kind', ['single thread', 'threads'])
def test_nodes_beside_a_spinning_executor(
        spin: Callable[[Executor], Spinning], kind: str,
        create: Callable[[], ClosableNode]) -> None:
    spinning = spin(EXECUTORS[kind]())
    for _ in range(NODES):
        node = create()
        spinning.executor.add_node(node)
        spinning.check()
        assert node.close() == 0
        spinning.executor.remove_node(node)
        spinning.check()
        node.destroy_node()


@pytest.mark.parametrize('kind', EXECUTORS)
def test_destruction_during_a_call(
        spin: Callable[[Executor], Spinning], kind: str) -> None:
    spinning = spin(EXECUTORS[kind]())
    is_called, is_destroyed = Event(), Event()
    ends: list[bool] = []

    def receive(_: Frame) -> None:
        is_called.set()
        ends.append(is_destroyed.wait(0.3))

    def destroy() -> None:
        subscriber.destroy()
        ends.append(True)
        is_destroyed.set()

    subscriber = FrameSubscriber(spinning.node, TOPIC, receive)
    assert is_called.wait(LONGEST_SECONDS)
    if kind == 'callback':
        spinning.executor.create_task(destroy)
    else:
        destroy()
    assert is_destroyed.wait(LONGEST_SECONDS)
    calls = len(ends)
    spinning.check()
    assert ends == [*[False] * (calls - 1), True]
