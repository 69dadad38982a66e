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

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread
import time

from conftest import DEADLINE
from opencv_tools.capture.bag import BagSource
from opencv_tools.capture.frame import Recorded
from opencv_tools.logs import Log
from opencv_tools.nodes.publisher.topic_player import TopicPlayer
from played_bags import BEGAN_NS, Entry, image_entry, NANO, write_mcap
import pytest
from rclpy.node import Node
from rclpy.serialization import serialize_message
from std_msgs.msg import String

HOUR_NS = 3600 * NANO
Play = Callable[..., TopicPlayer]

pytestmark = pytest.mark.process


def spoken(text: str, log_ns: int) -> Entry:
    return Entry(log_ns, bytes(serialize_message(String(data=text))), '/said',
                 'std_msgs/msg/String')


@pytest.fixture
def play(node: Node, tmp_path: Path) -> Iterator[Play]:
    """Return a function that plays messages around three images, which are hours apart."""
    players = []

    def _play(*, from_start: bool = True) -> TopicPlayer:
        images = [image_entry(number)._replace(log_ns=BEGAN_NS + number * HOUR_NS)
                  for number in range(3)]
        texts = [spoken(f'{part}', BEGAN_NS + round((part - 0.5) * HOUR_NS)) for part in range(4)]
        early = [spoken('soon', image.log_ns + 1) for image in images]
        source = BagSource(write_mcap(tmp_path / 'a.mcap', sorted([*images, *texts, *early])))
        players.append(TopicPlayer(
            node, source, ['/sa*'], Log(node.get_logger()), from_start=from_start))
        source.close()
        return players[-1]

    yield _play
    for player in players:
        player.close()


def recorded(number: int, play: int = 0) -> Recorded:
    return Recorded(message=None, topic='', log_ns=BEGAN_NS + number * HOUR_NS, play=play)


def assert_count(player: TopicPlayer, count: int) -> None:
    """Wait for a number of messages; those after them are an hour away."""
    deadline = time.monotonic() + DEADLINE
    while player.count < count and time.monotonic() < deadline:
        time.sleep(0.01)
    assert player.count == count


def test_messages_keep_their_place_among_frames(play: Play) -> None:
    player = play()
    player.advance(recorded(0))
    assert player.count >= 1  # the one before the first frame
    assert_count(player, 2)
    player.advance(recorded(1))  # the rest before it at once
    assert_count(player, 4)
    player.advance(recorded(2))
    assert_count(player, 6)


def test_frames_that_are_not_played(play: Play) -> None:
    player = play(from_start=False)
    player.advance(recorded(1))
    assert_count(player, 1)  # only the one that is due after it
    player.advance(recorded(2))
    assert_count(player, 3)


def test_each_play_begins_anew(play: Play) -> None:
    player = play()
    player.advance(recorded(0))
    assert_count(player, 2)
    player.advance(recorded(0, play=1))
    assert_count(player, 4)


def test_close_while_a_message_is_awaited(play: Play) -> None:
    player = play()
    player.advance(recorded(0))
    waiting = Thread(target=player.finish)
    waiting.start()
    player.close()
    waiting.join(DEADLINE)
    assert not waiting.is_alive()
