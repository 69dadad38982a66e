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
from functools import partial
from pathlib import Path
from threading import Thread
import time
from typing import Any

from conftest import spin_until
from console import Console
from opencv_tools.bags.offered_qos import offered_qos_text, OfferedQos
from opencv_tools.bags.reading import BagTopic
from opencv_tools.bags.schemas import CAMERA_INFO
from opencv_tools.capture.bag import BagSource
from opencv_tools.capture.frame import Recorded
from opencv_tools.nodes.publisher import topic_player as module
from opencv_tools.nodes.publisher.topic_player import (
    differences, playback_qos, played_topics, TopicPlayer)
from played_bags import BEGAN_NS, Entry, image_entry, NANO, write_mcap
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from waiting import join, wait_until

HOUR_NS = 3600 * NANO
LATCHED = offered_qos_text([OfferedQos(depth=1, durability=1)])
Play = Callable[..., TopicPlayer]

pytestmark = pytest.mark.process


def spoken(text: str, log_ns: int, **fields: Any) -> Entry:
    return Entry(log_ns, bytes(serialize_message(String(data=text))), '/said',
                 'std_msgs/msg/String')._replace(**fields)


def images(count: int = 3) -> list[Entry]:
    return [image_entry(number)._replace(log_ns=BEGAN_NS + number * HOUR_NS)
            for number in range(count)]


@pytest.fixture
def console() -> Console:
    return Console()


@pytest.fixture
def play_entries(node: Node, tmp_path: Path, console: Console) -> Iterator[Play]:
    """Return a function that plays a bag of images and other messages."""
    players = []

    def _play(entries: list[Entry], patterns: str = '/sa*', *,
              from_start: bool = True) -> TopicPlayer:
        source = BagSource(write_mcap(tmp_path / 'a.mcap', sorted(entries)))
        players.append(TopicPlayer(
            node, source, patterns.split(), console, from_start=from_start))
        source.close()
        return players[-1]

    yield _play
    for player in players:
        player.close()


@pytest.fixture
def play(play_entries: Play) -> Play:
    """Return a function that plays messages around three images, which are hours apart."""
    texts = [spoken(f'{part}', BEGAN_NS + round((part - 0.5) * HOUR_NS)) for part in range(4)]
    early = [spoken('soon', image.log_ns + 1) for image in images()]
    return partial(play_entries, [*images(), *texts, *early])


def recorded(number: int, play: int = 0) -> Recorded:
    return Recorded(message=None, topic='', log_ns=BEGAN_NS + number * HOUR_NS, play=play)


def assert_count(player: TopicPlayer, count: int) -> None:
    """Wait for a number of messages; those after them are an hour away."""
    wait_until(lambda: player.count >= count, f'{count} messages', messages=lambda: player.count)
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


def test_message_that_is_far_away(
        play: Play, console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, '_PATIENCE_SECONDS', 0.1)
    player = play()
    player.advance(recorded(0))
    wait_until(lambda: any('is due in' in line for line in console.lines), 'the line',
               lines=lambda: [*console.lines])
    with player._pace.changed:
        player._pace.changed.notify_all()  # it waits on, and logs no second time
    player.close()
    line, = (line for line in console.lines if 'is due in' in line)
    assert line.startswith('info: the next message of other topics is due in 1')  # less than 1800


def test_frames_that_are_not_played(play: Play) -> None:
    player = play(from_start=False)
    player.advance(recorded(1))
    assert_count(player, 1)  # only the one that is due after it
    player.advance(recorded(2))
    assert_count(player, 3)


def test_each_play_begins_anew(play_entries: Play) -> None:
    player = play_entries([
        *images(2), spoken('early', BEGAN_NS - NANO // 5), spoken('before', BEGAN_NS - 1),
        spoken('soon', BEGAN_NS + 1), spoken('tail', BEGAN_NS + HOUR_NS + 2)])
    for number in range(3):
        began = time.monotonic()
        player.advance(recorded(0, number))
        assert time.monotonic() - began > 0.19  # the time between the messages before the image
        player.advance(recorded(1, number))
    player.finish()
    assert player.count == 12


def test_messages_after_an_image_that_is_held(play_entries: Play) -> None:
    player = play_entries([*images(1), spoken('tail', BEGAN_NS + NANO // 5)])
    began = time.monotonic()
    player.advance(recorded(0))
    anchor = player._pace._anchor
    player.advance(recorded(0))
    assert player._pace._anchor is anchor
    wait_until(lambda: player.advance(recorded(0)) or player.count, 'the tail')
    assert time.monotonic() - began > 0.2


def test_end_before_the_next_image(play: Play) -> None:
    player = play()
    player.advance(recorded(0))
    player._pace._anchor = BEGAN_NS + HOUR_NS, time.monotonic()  # as if an hour had passed
    player.finish()
    assert_count(player, 3)  # not those after the second image


def test_latched_messages_before_the_first_frame(play_entries: Play, node: Node) -> None:
    latched = [spoken(text, BEGAN_NS - hours * HOUR_NS, topic='/sa_static', qos=2 * LATCHED)
               for text, hours in (('a', 2), ('b', 1))]
    player = play_entries([*images(), *latched, spoken('left out', BEGAN_NS - 1)],
                          from_start=False)
    player.advance(recorded(1))
    assert player.count == 2
    received: list[str] = []
    node.create_subscription(
        String, '/sa_static', lambda message: received.append(message.data),
        QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    spin_until(node, lambda: len(received) == 2)
    assert received == ['a', 'b']


def test_camera_info_of_the_images_is_not_played_twice(tmp_path: Path) -> None:
    info = Entry(BEGAN_NS, b'', '/camera/camera_info', CAMERA_INFO)
    source = BagSource(write_mcap(tmp_path / 'a.mcap', sorted([
        *images(), info, info._replace(topic='/other/camera_info')])))
    assert [topic.name for topic in played_topics(source, ['*'])] == ['/other/camera_info']
    source.close()


def test_more_topics_than_the_limit(
        play_entries: Play, console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, '_MAX_TOPICS', 2)
    play_entries([*images(), *(spoken('', BEGAN_NS, topic=f'/sa{number}') for number in range(5))])
    assert console.lines == [
        'warning: 3 topics of the bag are not published, from /sa2 on: 5 match, 2 are the limit',
        'info: Publishing 2 topics of the bag: /sa0 /sa1']


@pytest.mark.parametrize(('fields', 'reason'), [
    ({'encoding': 'protobuf'}, '/said is not published: its messages are protobuf, not cdr'),
    ({'encoding': 'json'}, '/said is not published: its messages are json, not cdr'),
    ({'definition': 'int999 a'}, '/said is not published: the definition of '),
    ({'type_name': 'a type'}, "/said is not published: 'a type' is not a message type"),
    ({'topic': '/sa-id'}, '/sa-id is not published: Invalid topic name'),
])
def test_topic_that_cannot_be_published(
        play_entries: Play, console: Console, fields: dict[str, Any], reason: str) -> None:
    """The only line has the reason; that no topic matches would be wrong."""
    play_entries([*images(), spoken('', BEGAN_NS, **fields)], '/*')
    line, = console.lines
    assert line.startswith(f'warning: {reason}')


def test_second_type_of_a_topic(play_entries: Play, console: Console) -> None:
    """The reason is without the lines of rclpy and the middleware."""
    play_entries([*images(), spoken('', BEGAN_NS),
                  spoken('', BEGAN_NS, type_name='std_msgs/msg/Bool')])
    line, other = console.lines
    assert line.startswith('warning: /said is not published: Failed to create publisher: ')
    assert 'incompatible type' in line and '.cpp' not in line and '.c:' not in line
    assert other == 'info: Publishing 1 topics of the bag: /said'


def test_no_topic_that_matches(play_entries: Play, console: Console) -> None:
    play_entries([*images(), spoken('', BEGAN_NS)], '/other /a*')
    assert console.lines == [
        'warning: No topic of the bag is published: none matches /other /a*']


def test_second_definition_of_a_topic(play_entries: Play, console: Console) -> None:
    first = Entry(BEGAN_NS - 3, b'\0\1\0\0\0\0\0\0', '/said', 'two_msgs/msg/A', 'int32 a')
    player = play_entries([
        *images(), first, first._replace(log_ns=BEGAN_NS - 2, definition='int32  a  # the same'),
        first._replace(log_ns=BEGAN_NS - 1, definition='float32 b')])
    player.advance(recorded(0))
    assert player.count == 2
    assert ('warning: messages of /said are not published: their definition of two_msgs/msg/A is '
            'not that of the first ones') in console.lines


def test_type_of_a_package_without_messages(play_entries: Play, console: Console) -> None:
    player = play_entries([*images(), Entry(
        BEGAN_NS - 1, b'\0\1\0\0\1\0\0\0', '/said', 'std_srvs/msg/Lid', 'bool is_open')])
    player.advance(recorded(0))
    assert player.count == 1, console.lines


@pytest.mark.parametrize(('rate', 'stamp', 'remedies'), [
    (0.0, 'original', []), (60.0, 'original', ['publish_rate:=0.0']),
    (0.0, 'capture', ['stamp:=original']),
    (10.0, 'publish', ['publish_rate:=0.0', 'stamp:=original']),
])
def test_differences_from_the_bag(rate: float, stamp: str, remedies: list[str]) -> None:
    found = differences(rate, stamp)
    assert len(found) == len(remedies)
    for sentence, remedy in zip(found, remedies):
        assert remedy in sentence
        assert ('stamp' in sentence) == ('stamp' in remedy)


@pytest.mark.parametrize(('offers', 'count', 'depth', 'policies'), [
    ([], 50, 10, 'RELIABLE VOLATILE'),
    ([OfferedQos(depth=5), OfferedQos(depth=7)], 50, 7, 'RELIABLE VOLATILE'),
    ([OfferedQos(depth=0)], 50, 10, 'RELIABLE VOLATILE'),
    ([OfferedQos(depth=1, history=2)], 50, 10, 'RELIABLE VOLATILE'),
    ([OfferedQos(depth=20), OfferedQos(reliability=2)], 50, 20, 'BEST_EFFORT VOLATILE'),
    ([OfferedQos(depth=9999)], 50, 1000, 'RELIABLE VOLATILE'),
    (2 * [OfferedQos(depth=1, durability=1)], 50, 2, 'RELIABLE TRANSIENT_LOCAL'),
    (2 * [OfferedQos(depth=0, durability=1)], 50, 50, 'RELIABLE TRANSIENT_LOCAL'),
    (2 * [OfferedQos(depth=0, durability=1)], 2, 20, 'RELIABLE TRANSIENT_LOCAL'),
    ([OfferedQos(depth=0, history=3, durability=1)], 9999, 1000, 'RELIABLE TRANSIENT_LOCAL'),
    ([OfferedQos(durability=1), OfferedQos(durability=2)], 50, 10, 'RELIABLE VOLATILE'),
])
def test_recorded_quality_of_service(
        offers: list[OfferedQos], count: int, depth: int, policies: str) -> None:
    qos = playback_qos(BagTopic('/a', 'b/msg/B', qos=offered_qos_text(offers)), count)
    assert (qos.depth, f'{qos.reliability.name} {qos.durability.name}') == (depth, policies)
    assert qos.history.name == 'KEEP_LAST'


def test_close_while_a_message_is_awaited(play: Play) -> None:
    player = play()
    player.advance(recorded(0))
    waiting = Thread(target=player.finish)
    waiting.start()
    player.close()
    join(waiting)
    assert not waiting.is_alive()
