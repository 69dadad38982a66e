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

"""Recording sessions without a publisher."""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path
import re

from conftest import recorded_files
from console import Console
import cv2
import numpy as np
from opencv_tools.bags.writing import BagChannel
from opencv_tools.nodes.subscriber.parameters import RecorderSettings
from opencv_tools.nodes.subscriber.session import SubscriberSession
from opencv_tools.recording.bag_sink import MessageBatch, RecordedMessage
from opencv_tools.recording.errors import Unwritten
from opencv_tools.recording.image_encoder import EncoderSettings
from opencv_tools.recording.naming import FileNames, FrameMetadata
from opencv_tools.recording.open_sink import open_sink
from opencv_tools.recording.recorder import FrameCounts, Recorder
from opencv_tools.recording.selection import Limits, Selection
from opencv_tools.recording.session import RecordingSession
from opencv_tools.topics.errors import ParameterError
import pytest
from rclpy.node import Node
from recordings import frame_of, gray_frame
from stepped_clock import SteppedClock

CHANNEL = BagChannel(topic='/said', type_name='a_msgs/msg/A', definition='int8 a')


def batch() -> MessageBatch:
    message = RecordedMessage(channel=CHANNEL, parts=(b'abcd',), log_ns=5, publish_ns=5)
    return MessageBatch(
        metadata=FrameMetadata(5, '', '', '/video_frames'), receive_ns=5, messages=(message,))


def test_messages_after_the_maximum_duration(node: Node, tmp_path: Path) -> None:
    clock, ended = SteppedClock(), []
    session = SubscriberSession(node, RecorderSettings(
        output_dir=str(tmp_path), file_name='a.mcap', topics='/said', max_duration=7.0),
        Console(), lambda: ended.append(clock.now))
    session._selection = Selection(1, 0.0, Limits(max_seconds=7.0), clock.monotonic)
    results: list[Path | Unwritten] = []
    items = [batch() for _ in range(3)]
    for item, seconds in zip(items, (0.0, 6.0, 2.0)):
        clock.step_to(clock.now + seconds)
        session.record_messages(item, results.append)
    session.close()
    assert [item.result.written for item in items] == [1, 1, 0]
    assert [(str(result), result.kind) for result in results if isinstance(result, str)] == [
        ('the recording has reached its limits', 'skipped')]
    assert ended


@pytest.mark.parametrize(('name', 'high', 'reason'), [
    ('a.mp4', 0.0, 'colors is turbo, but has an effect with lossy and a range in pictures and '
                   'videos only: set lossy, range_high'),
    ('a.mcap', 5000.0, 'range_high is 5000, but .mcap keeps all numbers: leave the range out'),
    ('{seq}.npy', 5000.0, 'range_high is 5000, but .npy keeps all numbers: leave the range out')])
def test_colours_without_an_effect(name: str, high: float, reason: str) -> None:
    with pytest.raises(ParameterError, match=f'^parameter {re.escape(reason)}'):
        RecorderSettings(file_name=name, colors='turbo', lossy=True, range_high=high)


def test_colours_of_recorded_depth(node: Node, tmp_path: Path) -> None:
    session = SubscriberSession(node, RecorderSettings(
        output_dir=str(tmp_path), file_name='a.png', lossy=True, range_low=1.0,
        range_high=5000.0, colors='jet'), Console(), lambda: None)
    session.record(frame_of(np.array([[0, 1, 5000]], np.uint16), '16UC1'))
    session.close()
    image = cv2.imread(str(tmp_path / 'a.png'), cv2.IMREAD_UNCHANGED)
    assert image.tolist() == [[[0, 0, 0], [128, 0, 0], [0, 0, 128]]]


@pytest.mark.parametrize(('limits', 'counts'), [
    (Limits(), FrameCounts(written=10, skipped=10)),
    (Limits(max_frames=3), FrameCounts(written=3, skipped=17)),
    (Limits(max_seconds=5.0), FrameCounts(written=3, skipped=17))])
def test_every_frame_is_in_one_count(
        tmp_path: Path, limits: Limits, counts: FrameCounts) -> None:
    clock, console = SteppedClock(), Console()
    sink = open_sink(tmp_path, FileNames('{seq}.png'), EncoderSettings('.png'), 'continue',
                     Limits(), sync=False)
    session = RecordingSession(
        Recorder(sink, console, block=True), lambda: None,
        Selection(2, 0.0, limits, clock.monotonic))
    for number in range(20):
        session.record(gray_frame(number))
        clock.step_to(clock.now + 1)
    session.others.failed += 1
    session.others.unprocessed += 2
    session.recorder.close()
    assert session.counts == counts + FrameCounts(failed=1, unprocessed=2)
    assert len(recorded_files(tmp_path)) == counts.written
    assert session.path and session.path.parent == tmp_path


def test_frames_after_the_recorder_was_abandoned(tmp_path: Path) -> None:
    sink = open_sink(tmp_path, FileNames('a.mcap'), EncoderSettings('.mcap'), 'continue',
                     Limits(), sync=False)
    session = RecordingSession(Recorder(sink, Console(), writers=1), lambda: None)
    for number in range(30):
        session.record(gray_frame(number))
        if number == 10:
            session.recorder.abandon()
    assert not session.wait_for_room(float('inf'))
    session.recorder.close()
    assert sum(astuple(session.counts)) == 30
