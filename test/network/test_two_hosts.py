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

"""
Publisher and subscriber on two hosts: over a slow cable, with losses, cut, and without multicast.

Both hosts are on this machine. Each has a network and a /dev/shm of its own, so that nothing but
the cable joins them, and the cable counts what it carries.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
import re
import time

from conftest import NodeProcess, read_manifest, recorded_files
import cv2
from hosts import Host, linked_hosts, two_hosts
from images import draw_pattern
import numpy as np
import pytest
from waiting import pause, wait_until

Start = Callable[..., NodeProcess]
Tell = Callable[[str], None]
Hosts = tuple[Host, Host]

CUT_SECONDS = 5.0
SILENCE_SECONDS = 5.0
FIRST_FRAMES = 60
NO_MULTICAST = ('table inet multicast { chain in { type filter hook input priority -1; '
                'ip daddr 224.0.0.0/4 drop; }; }')
NOTHING = 'table inet cut { chain in { type filter hook input priority -1; drop; }; }'


@pytest.fixture
def hosts(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hosts]:
    """Create the hosts of publisher and subscriber, which discover one another."""
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    with two_hosts(getattr(request, 'param', 'datagrams')) as pair:
        yield pair


def describe(subscriber: NodeProcess, sent: int, seconds: float, near: Host, far: Host) -> str:
    """Return a text with the result of a transfer."""
    received, rate = re.search(r'Received (\d+) frames at ([\d.]+) Hz', subscriber.output).groups()
    return (f'{received} of {sent} received at {rate} Hz in {seconds:.1f} s, '
            f'{near.sent_bytes() / 1e6:.1f} MB there and {far.sent_bytes() / 1e6:.2f} MB back, '
            f'lost on the cable {far.lost()} and {near.lost()}')


def finish_both(subscriber: NodeProcess, publisher: NodeProcess) -> float:
    """Wait for the end of both; the seconds that the frames took."""
    publisher.wait_for('Publishing video frame 1:')
    began = time.monotonic()
    assert subscriber.finish() == 0, subscriber.output
    seconds = time.monotonic() - began
    assert publisher.finish() == 0, publisher.output
    return seconds


def finish_one(subscriber: NodeProcess) -> float:
    """Wait for the end of a subscriber; the seconds that the frames took."""
    subscriber.wait_for('Receiving video frame')
    began = time.monotonic()
    assert subscriber.finish() == 0, subscriber.output
    return time.monotonic() - began


def test_packet_loss_of_the_link(hosts: Hosts) -> None:
    near, far = hosts
    near.run('python3', '-c', 'import socket; cable = socket.socket(type=socket.SOCK_DGRAM); '
             f'[cable.sendto(b".", ("{far.address}", 9)) for _ in range(20_000)]')
    assert 2 <= far.lost() <= 60


# With a packet the whole datagram is lost: of those of 64 KB, which travel in 45, 4 %. The kernel
# keeps what is left of each for 30 s, and after 40 of them has no memory for others: nothing
# arrives any more. The remedy is that of the DDS tuning guide of ROS 2.
@pytest.mark.parametrize(('hosts', 'rate'), [('datagrams', 10), ('packets', 5)],
                         indirect=['hosts'])
def test_raw_frames_arrive_pixel_for_pixel(
        hosts: Hosts, rate: int, start: Start, tmp_path: Path, tell: Tell) -> None:
    near, far = hosts
    count = 6 * rate
    far.run('sysctl', '-q', '-w', 'net.ipv4.ipfrag_time=3')
    subscriber = start('img_subscriber', within=far.within, output_dir=tmp_path / 'out',
                       file_name='frame_{seq:04d}.npy', max_frames=count, timeout=15,
                       transport='raw')
    publisher = start('img_publisher', within=near.within, source=f'pattern:640x480@{rate}',
                      publish_rate=0.0, max_frames=count, wait_for_subscribers=1)
    seconds = finish_both(subscriber, publisher)
    tell(f'raw 640x480 at {rate} Hz: {describe(subscriber, count, seconds, near, far)}')
    frames = [np.load(path) for path in recorded_files(tmp_path / 'out')]
    assert len(frames) == count
    assert all(np.array_equal(frame, draw_pattern(number, 640, 480))
               for number, frame in enumerate(frames))
    assert near.sent_bytes() > sum(frame.nbytes for frame in frames)


def test_compressed_1080p30_arrives_complete(
        hosts: Hosts, start: Start, tmp_path: Path, tell: Tell) -> None:
    near, far = hosts
    count = 180
    subscriber = start('img_subscriber', within=far.within, output_dir=tmp_path / 'out',
                       transport='compressed', file_name='frame_{seq:06d}.jpg', max_frames=count,
                       timeout=15)
    publisher = start('img_publisher', within=near.within, source='pattern:1920x1080@30',
                      publish_rate=0.0, max_frames=count, wait_for_subscribers=1)
    seconds = finish_both(subscriber, publisher)
    tell(f'compressed 1920x1080 at 30 Hz: {describe(subscriber, count, seconds, near, far)}')
    assert len(read_manifest(tmp_path / 'out')) == count
    files = recorded_files(tmp_path / 'out')
    assert all(path.read_bytes().endswith(b'\xff\xd9') for path in files)
    for number in range(0, count, 20):
        picture = cv2.imread(str(files[number]))
        assert cv2.norm(picture, draw_pattern(number, 1920, 1080), cv2.NORM_L1) < picture.size
    assert near.sent_bytes() > sum(path.stat().st_size for path in files)


def test_video_is_preferred_on_another_host(
        hosts: Hosts, start: Start, tmp_path: Path, tell: Tell) -> None:
    near, far = hosts
    start('img_publisher', within=near.within, source='pattern:640x480@30', publish_rate=0.0)
    subscriber = start('img_subscriber', within=far.within, output_dir=tmp_path / 'out')
    subscriber.wait_for('Receiving /video_frames/ffmpeg (ffmpeg_image_transport_msgs/msg/')
    written, sent = len(recorded_files(tmp_path / 'out')), near.sent_bytes()
    subscriber.wait_until(lambda _: len(recorded_files(tmp_path / 'out')) > written + 60)
    sent = near.sent_bytes() - sent
    subscriber.interrupt()
    assert subscriber.finish() == 0, subscriber.output
    tell(f'video 640x480 at 30 Hz: {sent / 60e3:.1f} kB for each of 60 frames')
    assert sent < 60 * 640 * 480 * 3 / 20
    assert re.search(r' 0 dropped, 0 failed, \d+ lost in transit', subscriber.output)


def first_frames(
        start: Start, tmp_path: Path, rate: str, transport: str, begins: str,
) -> tuple[int, float]:
    """
    Record the first frames of a publisher over a link.

    :param rate: rate of the link, as ``tc`` reads it.
    :param begins: which one starts first, ``publisher`` or ``subscriber``.
    :returns: bytes on the link, and seconds from the start of both to the first frame.
    """
    def publish() -> NodeProcess:
        return start('img_publisher', within=near.within, source='pattern:640x360@20',
                     publish_rate=0.0)

    with linked_hosts(rate, '32kb', '400ms') as (near, far):
        began, sent = time.monotonic(), near.sent_bytes()
        early = publish() if begins == 'publisher' else None
        subscriber = start('img_subscriber', within=far.within, output_dir=tmp_path / transport,
                           transport=transport, max_frames=FIRST_FRAMES)
        subscriber.wait_for('Waiting for')
        publisher = early or publish()
        subscriber.wait_for('Receiving video frame')
        seconds = time.monotonic() - began
        assert subscriber.finish() == 0, subscriber.output
        sent = near.sent_bytes() - sent
        publisher.interrupt()
        publisher.finish()
    return sent, seconds


# Raw images of one second would be 14 MB.
@pytest.mark.parametrize('begins', ['publisher', 'subscriber'])
@pytest.mark.parametrize('rate', ['2mbit', '8mbit', '30mbit', '100mbit'])
def test_nothing_but_video_on_a_slow_link(
        start: Start, tmp_path: Path, tell: Tell, monkeypatch: pytest.MonkeyPatch,
        rate: str, begins: str) -> None:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    sent = {}
    for transport in ('video', 'auto'):
        sent[transport], seconds = first_frames(start, tmp_path, rate, transport, begins)
        tell(f'{transport} over {rate}: first frame after {seconds:.1f} s, '
             f'{sent[transport] / 1e6:.2f} MB')
    assert sent['auto'] < 1.3 * sent['video']


def test_compressed_depth_is_preferred_on_another_host(
        hosts: Hosts, start: Start, tmp_path: Path, tell: Tell) -> None:
    near, far = hosts
    start('img_publisher', within=near.within, source='pattern:depth:640x480@30', encoding="''",
          publish_rate=0.0, depth_format='rvl')
    subscriber = start('img_subscriber', within=far.within, output_dir=tmp_path / 'out')
    subscriber.wait_for('Receiving /video_frames/compressedDepth (sensor_msgs/msg/')
    written, sent = len(recorded_files(tmp_path / 'out')), near.sent_bytes()
    subscriber.wait_until(lambda _: len(recorded_files(tmp_path / 'out')) > written + 60)
    sent = near.sent_bytes() - sent
    subscriber.interrupt()
    assert subscriber.finish() == 0, subscriber.output
    tell(f'depth 640x480 at 30 Hz: {sent / 60e3:.1f} kB for each of 60 frames')
    assert sent < 60 * 640 * 480 * 2
    depth = cv2.imread(str(recorded_files(tmp_path / 'out')[-1]), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16 and depth.max() > 3000
    assert re.search(r' 0 dropped, 0 failed, \d+ lost in transit', subscriber.output)


@pytest.mark.parametrize('transport', ['video', 'compressed'])
def test_frames_on_a_lossy_link(
        hosts: Hosts, start: Start, tmp_path: Path, tell: Tell, transport: str) -> None:
    near, far = hosts
    topic = {'video': 'ffmpeg', 'compressed': 'compressed'}[transport]
    publisher = start('img_publisher', within=near.within, **{
        'source': 'pattern:640x480@30', 'publish_rate': 0.0, 'wait_for_subscribers': 1,
        'video_key_interval': 0.5,
        f'qos_overrides./video_frames/{topic}.publisher.reliability': 'best_effort'})
    subscriber = start('img_subscriber', within=far.within, output_dir=tmp_path / 'out',
                       transport=transport, max_frames=150)
    seconds = finish_one(subscriber)
    publisher.interrupt()
    assert publisher.finish() == 0, publisher.output
    tell(f'{transport} 640x480 at 30 Hz, best effort: '
         f'{describe(subscriber, 150, seconds, near, far)}')
    pictures = [cv2.imread(str(path)) for path in recorded_files(tmp_path / 'out')]
    assert len(pictures) == 150
    # Each picture is a whole one of the pattern, however many are lost.
    drawn = [draw_pattern(number, 640, 480) for number in range(400)]
    for picture in pictures[::30]:
        assert min(cv2.norm(picture, one, cv2.NORM_L1) for one in drawn) < 3 * picture.size


def send_without_multicast(hosts: Hosts, start: Start, tmp_path: Path) -> tuple[int, NodeProcess]:
    """Publish for some seconds; the subscriber's exit status, and the subscriber."""
    near, far = hosts
    for host in hosts:
        host.apply_rules(NO_MULTICAST)
    start('img_publisher', within=near.within, source='pattern:64x48', publish_rate=20.0)
    subscriber = start('img_subscriber', within=far.within, output_dir=tmp_path / 'out',
                       max_frames=10, timeout=SILENCE_SECONDS)
    return subscriber.finish(), subscriber


# Each node has the addresses of both hosts, as when all robots have the same settings.
@pytest.mark.parametrize('discovery', ['SUBNET', 'LOCALHOST'])
def test_static_peers_without_multicast(
        hosts: Hosts, discovery: str, start: Start, tmp_path: Path, tell: Tell,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', discovery)
    monkeypatch.setenv('ROS_STATIC_PEERS', ';'.join(host.address for host in hosts))
    began = time.monotonic()
    status, subscriber = send_without_multicast(hosts, start, tmp_path)
    tell(f'{discovery} with ROS_STATIC_PEERS, no multicast: 10 frames within '
         f'{time.monotonic() - began:.1f} s of the start')
    assert status == 0, subscriber.output
    assert len(recorded_files(tmp_path / 'out')) == 10


@pytest.mark.parametrize(('discovery', 'peers'), [
    ('SUBNET', ''), ('OFF', '10.77.0.1;10.77.0.2'),
])
def test_no_discovery_without_multicast_and_peers(
        hosts: Hosts, discovery: str, peers: str, start: Start, tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', discovery)
    monkeypatch.setenv('ROS_STATIC_PEERS', peers)
    status, subscriber = send_without_multicast(hosts, start, tmp_path)
    assert status == 1, subscriber.output
    assert 'no publisher on /video_frames' in subscriber.output
    assert recorded_files(tmp_path / 'out') == []


def pull_out(hosts: Hosts) -> None:
    hosts[0].disconnect()


def plug_in(hosts: Hosts) -> None:
    hosts[0].connect()


def drop_all(hosts: Hosts) -> None:
    for host in hosts:
        host.apply_rules(NOTHING)


def drop_none(hosts: Hosts) -> None:
    for host in hosts:
        host.run('nft', 'delete', 'table', 'inet', 'cut')


@pytest.mark.parametrize(('cut', 'heal'), [(pull_out, plug_in), (drop_all, drop_none)])
def test_recovery_after_a_cut_link(
        hosts: Hosts, cut: Callable[[Hosts], None], heal: Callable[[Hosts], None],
        start: Start, tmp_path: Path, tell: Tell) -> None:
    near, far = hosts
    subscriber = start('img_subscriber', within=far.within, output_dir=tmp_path / 'out',
                       file_name='frame_{seq:04d}.npy')
    publisher = start('img_publisher', within=near.within, source='pattern:320x240@10',
                      publish_rate=0.0, wait_for_subscribers=1)
    subscriber.wait_for(' Hz, ')
    cut(hosts)
    pause(1)
    before = len(recorded_files(tmp_path / 'out'))
    pause(CUT_SECONDS - 1)
    assert len(recorded_files(tmp_path / 'out')) == before
    heal(hosts)
    healed = time.monotonic()
    wait_until(lambda: len(recorded_files(tmp_path / 'out')) >= before + 10, '10 frames',
               files=lambda: len(recorded_files(tmp_path / 'out')))
    seconds = time.monotonic() - healed
    for process in (subscriber, publisher):
        process.interrupt()
        assert process.finish() == 0, process.output
    received, lost = map(int, re.search(
        r'Received (\d+) frames .* (\d+) lost in transit', subscriber.output).groups())
    tell(f'{cut.__name__} for {CUT_SECONDS:g} s: 10 frames within {seconds:.1f} s, '
         f'{received} received, {lost} lost')
