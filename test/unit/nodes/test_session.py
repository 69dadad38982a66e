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

"""Recording sessions without frames."""

from __future__ import annotations

from pathlib import Path

from console import Console
from opencv_tools.bags.writing import BagChannel
from opencv_tools.nodes.subscriber.parameters import RecorderSettings
from opencv_tools.nodes.subscriber.session import SubscriberSession
from opencv_tools.recording.bag_sink import MessageBatch, RecordedMessage
from opencv_tools.recording.errors import Unwritten
from opencv_tools.recording.naming import FrameMetadata
from opencv_tools.recording.selection import Limits, Selection
from rclpy.node import Node
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
