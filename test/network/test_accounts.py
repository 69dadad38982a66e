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

"""The accounts of both ends of a link with losses: their sums are exact, whatever is lost."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re

from conftest import NodeProcess, recorded_files
from hosts import two_hosts
from images import draw_pattern
import numpy as np
import pytest

Start = Callable[..., NodeProcess]
Tell = Callable[[str], None]

COUNT = 120
LIVE = """
import sys
import numpy as np
from opencv_tools.frames import FrameNode, main

def create_node():
    def publish():
        if number[0] == len(frames):
            print(f'{number[0]} published, {publisher.without_subscribers} unseen', flush=True)
        elif number[0] < len(frames):
            publisher.publish(frames[number[0]])
        number[0] += 1

    node = FrameNode('own')
    frames, number = np.load(sys.argv[1]), [0]
    publisher = node.publish_frames('video_frames')
    node.create_timer(1 / 30, publish)
    return node

sys.exit(main(create_node))
"""


@pytest.mark.parametrize('begins', ['publisher', 'subscriber'])
@pytest.mark.parametrize('kind', ['finite', 'live'])
@pytest.mark.parametrize('reliability', ['reliable', 'best_effort'])
@pytest.mark.parametrize('per_thousand', [0, 10, 50, 200])
def test_accounts_of_a_lossy_link(
        start: Start, tmp_path: Path, tell: Tell, monkeypatch: pytest.MonkeyPatch,
        per_thousand: int, reliability: str, kind: str, begins: str) -> None:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    frames = np.array([draw_pattern(number, 64, 48) for number in range(COUNT)])
    np.save(tmp_path / 'frames.npy', frames)
    program = tmp_path / 'live.py'
    program.write_text(LIVE)
    qos = {'qos_overrides./video_frames.publisher.reliability': reliability}

    def publish() -> NodeProcess:
        if kind == 'live':
            return start(str(program), str(tmp_path / 'frames.npy'), within=near.within, **qos)
        return start('img_publisher', within=near.within, source='pattern:64x48@30',
                     publish_rate=0.0, max_frames=COUNT, **qos)

    with two_hosts('datagrams', per_thousand) as (near, far):
        early = publish() if begins == 'publisher' else None
        subscriber = start('img_subscriber', within=far.within, output_dir=tmp_path / 'out',
                           file_name='frame_{seq:04d}.npy', on_overflow='block', transport='raw')
        subscriber.wait_for('Waiting for')
        publisher = early or publish()
        if kind == 'live':
            publisher.wait_for(f'{COUNT} published')
            publisher.interrupt()
        status = publisher.finish()
        subscriber.interrupt()
        assert subscriber.finish() == 0, subscriber.output
    assert status == 0, publisher.output
    number_of = {frame.tobytes(): number for number, frame in enumerate(frames)}
    numbers = [number_of[np.load(path).tobytes()] for path in recorded_files(tmp_path / 'out')]
    received, dropped, failed, lost = map(int, re.search(
        r'Received (\d+) frames .* (\d+) dropped, (\d+) failed, (\d+) lost in transit',
        subscriber.output).groups())
    unseen = re.search(r'(\d+) (?:unseen|without subscribers)', publisher.output)
    sent_from = int(unseen[1]) if unseen else 0
    tell(f'{COUNT} published, {sent_from} without subscribers, {received} received, {lost} lost')
    assert (dropped, failed, received) == (0, 0, len(numbers))
    assert numbers == sorted(set(numbers))
    before = re.search(r'(\d+) sent before the first received frame', subscriber.output)
    if not numbers:
        assert sent_from == COUNT or (reliability, kind) != ('reliable', 'finite')
        return
    assert numbers[0] == sent_from + int(before[1] if before else 0)
    assert received + lost == numbers[-1] + 1 - numbers[0]
    if reliability == 'reliable' and kind == 'finite':
        assert numbers[-1] == COUNT - 1
        assert not lost
    if not per_thousand and reliability == 'reliable':
        assert numbers == [*range(numbers[0], numbers[-1] + 1)]
