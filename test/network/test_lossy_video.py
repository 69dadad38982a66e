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

"""Video topics and JPEG on a link that loses a twentieth: right pictures, and exact counts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re

from conftest import NodeProcess, recorded_files
import cv2
from hosts import two_hosts
from numbered_pictures import number_of, picture
import pytest

Start = Callable[..., NodeProcess]
Tell = Callable[[str], None]

COUNT = 240
SCALE = 4  # 640x480
LOST = 50  # of a thousand
TOPICS = {'video': 'ffmpeg', 'compressed': 'compressed'}


def write_numbers(path: Path) -> Path:
    """Write a video of numbered pictures at 30 Hz."""
    first = picture(0, SCALE)
    writer = cv2.VideoWriter(
        str(path), cv2.VideoWriter.fourcc(*'MJPG'), 30.0, first.shape[1::-1])
    for number in range(COUNT):
        writer.write(picture(number, SCALE))
    writer.release()
    return path


@pytest.mark.parametrize('transport', TOPICS)
def test_numbers_on_a_lossy_link(
        start: Start, tmp_path: Path, tell: Tell, monkeypatch: pytest.MonkeyPatch,
        transport: str) -> None:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    source = write_numbers(tmp_path / 'numbers.avi')
    with two_hosts('datagrams', LOST) as (near, far):
        subscriber = start('img_subscriber', within=far.within, output_dir=tmp_path / 'out',
                           transport=transport, on_overflow='block')
        subscriber.wait_for('Waiting for')
        publisher = start('img_publisher', within=near.within, **{
            'source': source, 'publish_rate': 0.0, 'wait_for_subscribers': 1,
            'video_key_interval': 0.5,
            f'qos_overrides./video_frames/{TOPICS[transport]}.publisher.reliability':
                'best_effort'})
        assert publisher.finish() == 0, publisher.output
        subscriber.interrupt()
        assert subscriber.finish() == 0, subscriber.output
        assert far.lost() > 0
    numbers = [number_of(cv2.imread(str(path)), is_exact=False)
               for path in recorded_files(tmp_path / 'out')]
    received, dropped, failed, lost = map(int, re.search(
        r'Received (\d+) frames .* (\d+) dropped, (\d+) failed, (\d+) lost in transit',
        subscriber.output).groups())
    tell(f'{transport}: {received} received and {lost} lost of {COUNT}')
    assert (dropped, failed, received) == (0, 0, len(numbers))
    # Nothing wrong, twice or out of order.
    assert numbers[0] >= 0 and numbers == sorted(set(numbers)) and lost > 0
    # Frames after the last one that arrived are not known to be lost. The first message of a video
    # may need a lost one.
    # Messages of a video after its last picture count as lost, if they need a lost one.
    before = re.search(r'(\d+) sent before the first received frame', subscriber.output)
    begin = int(before[1] if before else 0)
    is_video = transport == 'video'
    assert begin <= numbers[0] and (is_video or begin == numbers[0])
    ends = range(numbers[-1] + 1, COUNT + 1) if is_video else [numbers[-1] + 1]
    assert received + lost in {end - begin for end in ends}
