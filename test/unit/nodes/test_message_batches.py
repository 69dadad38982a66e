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

"""Account of the messages of batches."""

from __future__ import annotations

from pathlib import Path

from console import Console
from opencv_tools.bags.writing import BagChannel
from opencv_tools.nodes.subscriber.topic_recorder import MessageBatches, RecordedTopic
from opencv_tools.recording.bag_sink import MessageBatch, RecordedMessage
from opencv_tools.recording.errors import Unwritten
from opencv_tools.recording.recorder import OnDone
import pytest

TF = BagChannel(topic='/tf', type_name='a_msgs/msg/A')


@pytest.mark.parametrize(('outcomes', 'account'), [
    ([(10, Path('a.mcap'))], '10 written, 0 lost in transit'),
    ([(7, Unwritten('', 'skipped')), (0, Unwritten('', 'skipped'))],
     '7 written, 0 lost in transit, 13 skipped'),
    ([(0, Unwritten('', 'dropped')), (4, Unwritten('', 'failed')), (10, Path('a.mcap')),
      (0, Unwritten('', 'not processed'))],
     '14 written, 10 dropped, 6 failed, 0 lost in transit, 10 not processed'),
])
def test_account(outcomes: list[tuple[int, Path | Unwritten]], account: str) -> None:
    waiting = [*outcomes]

    def put(batch: MessageBatch, on_done: OnDone) -> None:
        batch.result.written, outcome = waiting.pop(0)
        on_done(outcome)

    topic = RecordedTopic(TF)
    batches = MessageBatches('/video_frames', put, Console())
    for _ in outcomes:
        for number in range(10):
            topic.received += 1
            batches.add(topic, RecordedMessage(
                channel=TF, parts=(b'abcd',), log_ns=number, publish_ns=0))
        batches.flush()
    assert topic.account() == f'/tf: {10 * len(outcomes)} messages received, {account}'
