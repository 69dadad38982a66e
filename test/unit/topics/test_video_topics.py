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

"""Video topics: what publishers send, and what subscribers make of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress

from conftest import spin_until
import numpy as np
from opencv_tools.frames import Frame, FramePublisher, FrameSubscriber
from opencv_tools.image.cdr import WireHeader
from opencv_tools.image.errors import CdrError, KeyFrameNeeded
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition
from opencv_tools.topics.frame_topics import VideoTopics
from opencv_tools.video import stream
from opencv_tools.video.decoder import NumberedDecoder
from opencv_tools.video.encoder import VideoEncoder
from opencv_tools.video.messages import (
    cdr_to_video, COMPRESSED_VIDEO, FFMPEG_PACKET, video_to_cdr, VIDEO_TOPICS, WireVideo)
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.parameter_sets import parameter_sets
from opencv_tools.video.publisher_decoders import VideoDecoding
from opencv_tools.video.settings import VideoSettings
import pytest
from rclpy.node import Node
from std_msgs.msg import Header
from video_receiver import Receiver

Subscribe = Callable[..., tuple[FrameSubscriber, list[Frame]]]
TYPES = [*VIDEO_TOPICS]
SLOW_KEYS = VideoSettings(key_interval=3600.0)


def flat(number: int, height: int = 32, width: int = 48) -> np.ndarray:
    """Return a gray image that tells its number, after every codec."""
    return np.full((height, width, 3), number % 50 * 5, np.uint8)


def number_of(image: np.ndarray) -> int:
    return round(float(image.mean()) / 5)


class Sender:
    """Publish numbered images as video."""

    def __init__(self, node: Node, settings: VideoSettings = SLOW_KEYS) -> None:
        self.node = node
        self.topics = VideoTopics(node, '/video', settings)
        self.sent = 0

    def send(self, image: np.ndarray | None = None, encoding: str = 'bgr8') -> bool:
        self.sent += 1
        shown = flat(self.sent) if image is None else image
        return bool(self.topics.publish(
            lambda: (shown, encoding), WireHeader(self.sent, 0, 'eye')))

    def send_until(self, condition: Callable[[], object]) -> None:
        spin_until(self.node, lambda: self.send() is None or bool(condition()))


def test_second_key_frame_for_a_new_subscriber() -> None:
    now = 100.0  # steps of 1/8 s are exact
    video = stream.VideoStream(SLOW_KEYS, lambda: now)
    keys = []
    for step in range(40):
        video.requests = step >= 15
        keys += [step] * video.encode(flat(step), 'bgr8', step * 10 ** 8).is_key
        now += 0.125
    assert keys == [0, 15, 23]


def test_decoder_keeps_parameter_sets_after_a_loss() -> None:
    encoder = VideoEncoder(VideoSettings(key_interval=0.35), 48, 32, 30)
    sent = [encoder.encode(flat(number), 'bgr8', number * 10 ** 8).data for number in range(12)]
    bare = [sent[0], *(data.removeprefix(parameter_sets('h264', data)) for data in sent[1:])]
    decoder, shown = NumberedDecoder(), []
    for number, data in enumerate(bare):
        if number != 2:
            with suppress(KeyFrameNeeded):
                shown.append(number_of(decoder.decode('h264', data, number + 1)))
    assert shown == [0, 1, *range(4, 12)]


@pytest.fixture
def subscribe(node: Node) -> Iterator[Subscribe]:
    """Subscribe to frames, and return them."""
    subscribers = []

    def start(topic: str = 'video', transport: str = 'video',
              every: bool = True) -> tuple[FrameSubscriber, list[Frame]]:
        frames: list[Frame] = []
        subscribers.append(FrameSubscriber(
            node, topic, frames.append, every=every, transport=transport))
        return subscribers[-1], frames

    yield start
    for subscriber in subscribers:
        subscriber.destroy()


def packets(count: int, codec: str = 'h264') -> list[VideoPacket]:
    encoder = VideoEncoder(VideoSettings(codec=codec, key_interval=3600.0), 48, 32, 30.0)
    return [encoder.encode(flat(number), 'bgr8', number * 10**9, number == 5)
            for number in range(1, count + 1)]


def message(packet: VideoPacket, type_name: str = FFMPEG_PACKET) -> WireVideo:
    return cdr_to_video(type_name, video_to_cdr(
        type_name, WireHeader(7, 8, 'eye'), packet, 1))


@pytest.mark.parametrize('codec', ['h264', 'h265'])
@pytest.mark.parametrize('type_name', TYPES)
def test_pictures_of_each_codec(type_name: str, codec: str) -> None:
    decoding = VideoDecoding(1 << 20)
    for number, packet in enumerate(packets(6, codec), 1):
        image = decoding.decode(message(packet, type_name), b'a', number)
        assert image is not None
        assert (image.encoding, image.width, image.height) == ('bgr8', 48, 32)
        assert image.header == WireHeader(7, 8, 'eye')
        assert number_of(np.frombuffer(image.data, np.uint8)) == number


def test_numbers_of_published_packets(node: Node) -> None:
    sender, receiver = Sender(node), Receiver(node, FFMPEG_PACKET)
    sender.send_until(lambda: len(receiver.messages) > 3)
    codec = MessageCodec(read_definition(FFMPEG_PACKET))
    numbers = [codec.read(message.serialized)['pts'] for message in receiver.messages]
    assert numbers == [*range(numbers[0], numbers[0] + len(numbers))]
    sender.topics.destroy()


def test_lost_message_costs_those_until_the_next_key_frame() -> None:
    decoding = VideoDecoding(1 << 20)
    sent = [message(packet) for packet in packets(7)]
    found = [bool(decoding.decode(sent[number - 1], b'a', number)) for number in (1, 3, 4, 5, 6)]
    assert found == [True, False, False, True, True]
    assert decoding.decode(sent[6], b'b', 7) is None  # another publisher
    assert decoding.decode(sent[6], b'a', 7)


def test_messages_without_numbers_follow_each_other() -> None:
    decoding = VideoDecoding(1 << 20)
    assert all(decoding.decode(message(packet), b'a', 0) for packet in packets(4))


def test_pictures_above_the_maximum_are_refused() -> None:
    decoding = VideoDecoding(48 * 32 - 1)
    assert '48x32' in str(decoding.decode(message(packets(1)[0]), b'a', 1))


def test_decoders_of_few_publishers_are_kept() -> None:
    now = 100.0
    decoding, sent = VideoDecoding(1 << 20, lambda: now), [message(one) for one in packets(3)]
    names = [bytes((number,)) for number in range(9)]
    for name in names[:8]:
        assert not isinstance(decoding.decode(sent[0], name, 1), CdrError)
    found = decoding.decode(sent[0], names[8], 1)
    assert 'more than 8 publishers send video on one topic' in str(found)
    now += 1.5
    for name in names[1:8]:
        assert not isinstance(decoding.decode(sent[1], name, 2), CdrError | None)
    now += 1.0  # the first one is silent
    assert not isinstance(decoding.decode(sent[0], names[8], 2), CdrError | None)
    assert isinstance(decoding.decode(sent[1], names[0], 2), CdrError)


def test_both_topics_have_the_same_packets(node: Node) -> None:
    sender = Sender(node)
    receivers = [Receiver(node, type_name) for type_name in TYPES]
    sender.send_until(lambda: all(len(one.messages) > 3 for one in receivers))
    first, second = ({one.header.sec: bytes(one.data) for one in receiver.messages}
                     for receiver in receivers)
    common = first.keys() & second.keys()
    assert len(common) > 2
    assert all(first[stamp] == second[stamp] for stamp in common)
    packet, video = receivers[0].messages[-1], receivers[1].messages[-1]
    assert (packet.encoding, packet.size, packet.header.frame_id) == ('h264', (48, 32), 'eye')
    assert (video.encoding, video.size, video.header.frame_id) == ('h264', None, 'eye')


def test_nothing_is_encoded_without_subscribers(node: Node) -> None:
    topics = VideoTopics(node, '/video', SLOW_KEYS)
    assert topics.publish(
        lambda: pytest.fail('nobody receives it'), WireHeader(1, 0, '')) == []


@pytest.mark.thorough
@pytest.mark.parametrize('type_name', TYPES)
def test_late_subscriber_gets_a_key_frame(
        node: Node, subscribe: Subscribe, type_name: str) -> None:
    sender = Sender(node)
    first = Receiver(node, type_name)
    sender.send_until(lambda: len(first.messages) > 5)
    _, images = subscribe()
    sender.send_until(lambda: images)
    assert number_of(images[0].image) == images[0].stamp_ns // 10**9 % 50
    assert images[0].frame_id == 'eye'


def test_changed_settings_begin_with_a_key_frame(node: Node) -> None:
    sender = Sender(node)
    receiver = Receiver(node, FFMPEG_PACKET)
    sender.send_until(lambda: len(receiver.messages) > 3)
    sender.topics.stream.settings = VideoSettings(codec='h265')
    sender.send_until(lambda: receiver.messages[-1].encoding == 'h265')
    decoding = VideoDecoding(1 << 20)
    first = next(one for one in receiver.messages if one.encoding == 'h265')
    assert decoding.decode(first, b'', 0)


def test_images_without_video_are_refused_once(
        node: Node, capfd: pytest.CaptureFixture[str]) -> None:
    sender = Sender(node)
    receiver = Receiver(node, FFMPEG_PACKET)
    spin_until(node, lambda: sender.topics.count_subscribers())
    for _ in range(3):
        assert not sender.send(np.zeros((4, 4), np.uint16), 'mono16')
    assert capfd.readouterr().err.count('[plain]: no video: ') == 1
    sender.send_until(lambda: receiver.messages)


@pytest.mark.parametrize('size', [(33, 47), (1, 1), (32, 47)])
def test_odd_sizes_come_back(
        node: Node, subscribe: Subscribe, size: tuple[int, int]) -> None:
    sender = FramePublisher(node, 'video', video=SLOW_KEYS)
    _, frames = subscribe(every=False)

    def send() -> bool:
        sender.publish(flat(9, *size), Header(frame_id='eye'))
        return bool(frames)

    spin_until(node, send)
    assert frames[0].image.shape == (*size, 3)
    assert number_of(frames[0].image) == 9


def test_loan_is_published_as_video(node: Node, subscribe: Subscribe) -> None:
    sender = FramePublisher(node, 'video', video=SLOW_KEYS)
    (_, videos), (_, shared) = subscribe(), subscribe(transport='auto')

    def send() -> bool:
        with sender.loan(32, 48) as loan:
            loan.image[:] = 45
        return bool(videos and shared)

    spin_until(node, send)
    assert number_of(videos[0].image) == number_of(shared[0].image) == 9


def test_topic_of_video_itself(node: Node, subscribe: Subscribe) -> None:
    sender = Sender(node)
    _, frames = subscribe('video/foxglove', 'auto')
    sender.send_until(lambda: frames)
    assert number_of(frames[0].image) == frames[0].stamp_ns // 10**9 % 50


@pytest.mark.parametrize('content', [b'', b'no video', b'\0\0\0\1\x65' + bytes(50)])
def test_damaged_video_is_counted_and_the_next_is_received(
        node: Node, subscribe: Subscribe, content: bytes) -> None:
    sender = Sender(node)
    subscriber, frames = subscribe()
    sender.send_until(lambda: frames)
    bad = VideoPacket(codec='h264', data=content, is_key=True, width=48, height=32)
    sender.topics.publishers[FFMPEG_PACKET].publish(
        video_to_cdr(FFMPEG_PACKET, WireHeader(0, 0, 'bad'), bad, 1))
    sender.topics.stream.settings = VideoSettings(quality=20)  # its first frame is a key frame
    count = len(frames)
    sender.send_until(lambda: len(frames) > count + 3)
    assert 'bad' not in {frame.frame_id for frame in frames}
    assert subscriber.failed <= 1


def test_packets_without_a_key_frame_are_lost(node: Node, subscribe: Subscribe) -> None:
    sender = Sender(node)
    subscriber, frames = subscribe()
    publisher = sender.topics.publishers[FFMPEG_PACKET]
    spin_until(node, publisher.get_subscription_count)
    for number, packet in enumerate(packets(4)[1:], 1):
        publisher.publish(video_to_cdr(FFMPEG_PACKET, WireHeader(number, 0, ''), packet, number))
    spin_until(node, lambda: subscriber.skipped == 3)
    reason = subscriber._subscription.explain_no_frames()
    assert 'has video, but no key frame with parameter sets' in reason
    publisher.publish(video_to_cdr(FFMPEG_PACKET, WireHeader(9, 0, ''), packets(1)[0], 9))
    spin_until(node, lambda: frames)
    assert (subscriber.skipped, subscriber.failed, len(frames)) == (3, 0, 1)


def test_codec_that_is_not_known() -> None:
    packet = VideoPacket(codec='vp9', data=b'x', is_key=True, width=1, height=1)
    found = VideoDecoding(100).decode(message(packet), b'', 0)
    assert "codec 'vp9'; h264, h265 and av1 are decoded" in str(found)


def test_messages_of_another_type_are_no_video() -> None:
    for content in (b'', b'\0\1\0\0', bytes(40), b'\0\1\0\0' + b'\xff' * 60):
        for type_name in (FFMPEG_PACKET, COMPRESSED_VIDEO):
            with suppress(CdrError):
                found = cdr_to_video(type_name, content)
                assert isinstance(VideoDecoding(100).decode(found, b'', 0), CdrError)
