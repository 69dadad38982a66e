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

"""The publish loop without a thread of its own."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from conftest import spin_until
import numpy as np
from opencv_tools.capture.errors import BrokenFrameError
from opencv_tools.nodes.parameters import with_values
from opencv_tools.nodes.publisher.camera_controls import CameraControls
from opencv_tools.nodes.publisher.camera_info import PublishedCalibration
from opencv_tools.nodes.publisher.image_topics import ImageTopics
from opencv_tools.nodes.publisher.loop import PublishLoop
from opencv_tools.nodes.publisher.parameters import PARAMETERS, PublisherSettings
from opencv_tools.nodes.run_node import EXIT_FAILURE, EXIT_OK
from opencv_tools.topics.errors import ParameterError
from opencv_tools.transport.fastdds.profile import NOT_CONFIGURED
from played_bags import Entry, image_entry, write_mcap
import pytest
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import String
from std_srvs.srv import SetBool


def create_loop(node: Node, **values: Any) -> PublishLoop:
    topics = ImageTopics(
        node, 'video_frames', PublishedCalibration('', 'eye', print), NOT_CONFIGURED, 0)
    controls = CameraControls(node, PARAMETERS, lambda: None)
    return PublishLoop(node, with_values(PublisherSettings(), values), topics, controls)


def test_exit_after_max_frames(node: Node) -> None:
    loop = create_loop(node, source='pattern:64x48', publish_rate=0.0, max_frames=3)
    assert loop.run() == EXIT_OK
    assert loop.summary().startswith('Published 3 frames at ')
    assert loop.summary().endswith(' Hz, 0 dropped, 3 without subscribers '
                                   '(wait_for_subscribers:=1 waits for the first one)')
    assert loop.camera is None


def test_exit_without_a_source(
        node: Node, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    loop = create_loop(node, source=str(tmp_path / 'none.mp4'))
    assert loop.run() == EXIT_FAILURE
    assert 'none.mp4 cannot be opened: No such file or directory' in capfd.readouterr().err


def test_subscribers_are_waited_for_after_a_failure(
        node: Node, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_mcap(tmp_path / 'a.mcap', [image_entry(1)])
    loop = create_loop(node, source=str(path), publish_rate=0.0, on_end='loop')
    backlog = loop._topics.backlog
    waits: list[str] = []
    wait_for_room = backlog.wait_for_room
    monkeypatch.setattr(backlog, 'confirm_all', lambda _: waits.append('all'))
    monkeypatch.setattr(backlog, 'wait_for_room', lambda: (
        waits.append('room'), path.unlink(missing_ok=True), wait_for_room()))
    assert loop.run() == EXIT_FAILURE
    assert (waits[0], waits[-1]) == ('room', 'all')


def test_stop_before_the_first_frame(node: Node) -> None:
    loop = create_loop(node, source='pattern')
    loop.stop()
    assert loop.run() == EXIT_OK
    assert loop.summary() == 'Published 0 frames at 0.0 Hz, 0 dropped'


def test_changed_settings(node: Node) -> None:
    loop = create_loop(node, source='pattern')
    before = loop.settings
    loop.apply_changes({'rotate': 90, 'publish_rate': 5.0})
    assert (loop.settings.capture.rotate, loop.settings.capture.publish_rate) == (90, 5.0)
    assert loop.settings.source == 'pattern'
    assert before == PublisherSettings(source='pattern')


@pytest.mark.parametrize(('changes', 'reason'), [
    ({'video_preset': 'p3'}, "parameter video_preset is 'p3': give ultrafast"),
    ({'video_bit_rate': 5}, 'parameter video_bit_rate is 5: give 10000 to'),
    ({'video_codec': 'foo'}, "parameter video_codec is 'foo': the installed PyAV has no such"),
    ({'video_codec': 'libx264rgb'}, "parameter video_codec is 'libx264rgb', but encoder 'libx264r"
     "gb' cannot be opened for 640x480 images: "),
    ({'video_codec': 'libx265', 'video_preset': 'p3'}, "parameter video_preset is 'p3'")])
def test_changes_that_the_video_cannot_have(
        node: Node, changes: dict[str, Any], reason: str) -> None:
    loop = create_loop(node, source='pattern')
    with pytest.raises(ParameterError, match=reason):
        loop.check_changes(changes)
    loop.check_changes({'video_codec': 'libx265', 'video_preset': 'faster'})
    assert loop.settings == PublisherSettings(source='pattern')


def test_pause_without_an_open_source(node: Node) -> None:
    loop = create_loop(node, source='pattern')
    for data, message in ((False, 'paused'), (True, 'capturing')):
        response = loop.set_capture(SetBool.Request(data=data), SetBool.Response())
        assert (response.success, response.message) == (True, message)


def test_rate_of_lines_about_the_same_broken_frame(
        node: Node, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    loop = create_loop(node, source='pattern')
    now = 100.0
    monkeypatch.setattr('opencv_tools.base.logs.time', SimpleNamespace(monotonic=lambda: now))
    for reason in 'abbbbb':
        loop._events.broken(BrokenFrameError(f'reason {reason}'))
        now += 0.4
    output = capfd.readouterr().err
    assert [output.count(f'frame dropped: reason {reason}') for reason in 'ab'] == [1, 2]
    assert loop.summary().endswith(', 6 dropped')


def bag_with_messages(folder: Path) -> Path:
    """Create a bag of three images, with a message before each."""
    images = [image_entry(number) for number in range(3)]
    said = [Entry(image.log_ns - 1, bytes(serialize_message(String(data='a'))), '/said',
                  'std_msgs/msg/String') for image in images]
    return write_mcap(folder / 'a.mcap', sorted([*images, *said]))


@pytest.mark.parametrize(('first', 'count'), [(0, 3), (1, 1)])
def test_messages_before_the_first_frame(
        node: Node, tmp_path: Path, first: int, count: int) -> None:
    loop = create_loop(node, source=str(bag_with_messages(tmp_path)), topics='/said',
                       publish_rate=0.0, start_frame=first)
    assert loop.run() == EXIT_OK
    assert loop.summary().endswith(f'; {count} messages of other topics')
    loop.stop()


def test_stop_ends_the_other_topics(node: Node, tmp_path: Path) -> None:
    loop = create_loop(node, source=str(bag_with_messages(tmp_path)), topics='/said')
    assert loop.run() == EXIT_OK
    thread = loop._topic_player._thread
    assert thread.is_alive()
    loop.stop()
    assert not thread.is_alive()


def test_frames_before_the_first_subscriber(
        node: Node, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_mcap(tmp_path / 'a.mcap', [image_entry(number) for number in range(1, 8)])
    loop = create_loop(node, source=str(path), publish_rate=0.0)
    seen = iter([False, False, True, True, False, True, True])
    monkeypatch.setattr(loop._topics, 'publish', lambda *_, **__: next(seen))
    monkeypatch.setattr(loop._topics, 'has_subscribers', lambda of_frames=False: not of_frames)
    assert loop.run() == EXIT_OK
    assert loop.summary().endswith(' Hz, 0 dropped, 3 without subscribers '
                                   '(wait_for_subscribers:=1 waits for the first one)')


@pytest.mark.parametrize(('is_wanted', 'needs_key', 'said', 'counted'), [
    (True, True, 'waiting for a key frame of the source', 'waiting for a key frame of the source'),
    (True, False, 'not in a form with subscribers', 'in no form that its subscribers receive'),
    (False, True, 'no subscribers',
     'without subscribers (wait_for_subscribers:=1 waits for the first one)')])
def test_why_a_frame_is_not_sent(
        node: Node, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str], is_wanted: bool, needs_key: bool, said: str,
        counted: str) -> None:
    path = write_mcap(tmp_path / 'a.mcap', [image_entry(number) for number in range(3)])
    loop = create_loop(node, source=str(path), publish_rate=0.0)
    monkeypatch.setattr(loop._topics, 'publish', lambda *_, **__: False)
    monkeypatch.setattr(loop._topics, 'has_subscribers', lambda of_frames=False: is_wanted)
    monkeypatch.setattr(type(loop._topics), 'needs_key_frame', needs_key)
    assert loop.run() == EXIT_OK
    assert f'frame 1: {said}' in capfd.readouterr().err
    assert loop.summary().partition(' Hz, ')[2] == f'0 dropped, 3 {counted}'


@pytest.mark.parametrize(('subscribed', 'kind', 'encoding', 'unsent'), [
    ('video_frames', Image, '32FC1', ''),
    ('video_frames/compressed', CompressedImage, 'mono16', ''),
    ('video_frames/compressed', CompressedImage, '32FC3',
     ', 3 in no form that its subscribers receive'),
    ('camera_info', CameraInfo, 'bgr8', ', 3 without subscribers '
     '(wait_for_subscribers:=1 waits for the first one)'),
])
def test_frames_without_a_form_for_their_subscriber(
        node: Node, tmp_path: Path, subscribed: str, kind: type, encoding: str, unsent: str,
) -> None:
    dtype, shape = ('uint16', (4, 6)) if encoding == 'mono16' else (
        ('uint8', (4, 6, 3)) if encoding == 'bgr8' else
        ('float32', (4, 6, 3)[:2 + encoding.endswith('3')]))
    path = write_mcap(tmp_path / 'a.mcap', [
        image_entry(number, np.ones(shape, dtype), encoding) for number in range(1, 4)])
    loop = create_loop(node, source=str(path), publish_rate=0.0, encoding='')
    node.create_subscription(kind, subscribed, lambda _: None, 10)
    spin_until(node, loop._topics.has_subscribers)
    assert loop.run() == EXIT_OK
    assert loop.summary().partition(' Hz, ')[2] == f'0 dropped{unsent}'


@pytest.mark.parametrize('encoding', ['nv12', 'yuv422', 'bayer_rggb8'])
def test_encoding_that_the_frames_cannot_have(node: Node, encoding: str) -> None:
    loop = create_loop(node, source='pattern:64x48', publish_rate=0.0, max_frames=1)
    loop.check_changes({'encoding': encoding})  # no frame is known yet
    loop._topics.has_subscribers = lambda **_: True  # type: ignore[method-assign]
    assert loop.run() == EXIT_OK
    for accepted in ('mono16', 'rgba8', '', 'bgr8'):
        loop.check_changes({'encoding': accepted})
    with pytest.raises(ParameterError, match=f"parameter encoding is '{encoding}': .*; give ''"):
        loop.check_changes({'encoding': encoding})
