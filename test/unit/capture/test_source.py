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

"""Sources of frames and their playback, without ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
import errno
import os
from pathlib import Path
from threading import Event
import time
from typing import Any

from conftest import CLIP, CLIP_FRAMES, decode_clip
import cv2
from images import oriented_jpeg, UPRIGHT
import numpy as np
from opencv_tools.capture.clock import SYSTEM_CLOCK
from opencv_tools.capture.errors import BrokenFrameError, CaptureError
from opencv_tools.capture.frame import Frame, Source
from opencv_tools.capture.image_files import natural_order
from opencv_tools.capture.pattern import draw_pattern, parse_pattern, PatternSource, PatternSpec
from opencv_tools.capture.player import Pacer, PlaybackSettings, Player
from opencv_tools.capture.source import check_source, expected_size, open_source
from opencv_tools.capture.v4l2 import os_errors
from opencv_tools.capture.video import VideoSource
import pytest
from special_files import KINDS
from stepped_clock import BEGAN, SteppedClock


def play(source: Source, on_broken: Callable[[BrokenFrameError], object] = pytest.fail,
         stopped: Event | None = None, clock: SteppedClock | None = None,
         **settings: Any) -> Player:
    """Create a player that is never paused, with a clock whose waits take no time."""
    return Player(source, lambda: PlaybackSettings(**settings), stopped or Event(), lambda: False,
                  on_broken, clock or SteppedClock())


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


@pytest.fixture
def numbered(tmp_path: Path) -> Source:
    """Create a folder of four images with the numbers 0 to 3."""
    for number in range(4):
        cv2.imwrite(str(tmp_path / f'{number}.png'), np.full((2, 2), number, np.uint8))
    return open_source(str(tmp_path))


def frames_of(source: Source) -> Iterator[Frame]:
    return iter(source.read, None)


@pytest.mark.parametrize(('text', 'spec'), [
    ('pattern', PatternSpec(640, 480, 30.0)),
    ('pattern:320x240', PatternSpec(320, 240, 30.0)),
    ('pattern:1x1@12.5', PatternSpec(1, 1, 12.5)),
])
def test_pattern_is_parsed(text: str, spec: PatternSpec) -> None:
    assert parse_pattern(text) == spec


@pytest.mark.parametrize('text', [
    '', 'pattern:', 'pattern:640', 'pattern:0x480', 'pattern:640x480@0', 'pattern:640x480@1001',
    'pattern:99999x1', 'pattern:-1x5', 'pattern:640x480@30@30'])
def test_sources_that_cannot_be(text: str) -> None:
    with pytest.raises(ValueError):
        check_source(text)


@pytest.mark.parametrize(('width', 'height'), [(640, 480), (1, 1), (3, 200), (200, 3), (1921, 7)])
def test_pattern_frames_differ_and_repeat_exactly(width: int, height: int) -> None:
    source = PatternSource(PatternSpec(width, height))
    first, second = source.read().image, source.read().image
    assert first.shape == (height, width, 3)
    assert np.array_equal(second, draw_pattern(1, width, height))
    if width >= 200:
        assert not np.array_equal(first, second)
    source.rewind()
    assert source.skip()
    assert np.array_equal(source.read().image, second)


def test_pattern_shows_its_number() -> None:
    images = {draw_pattern(number, 640, 480)[160:320, 200:440].tobytes()
              for number in range(0, 640, 64)}
    assert len(images) == 10  # the moving line has the same position, so only the digits differ


def test_video_gives_every_frame_and_its_rate() -> None:
    source = open_source(str(CLIP))
    assert source.rate == 25.0 and not source.live
    for expected, frame in zip(decode_clip(), frames_of(source), strict=True):
        assert frame.encoding == 'bgr8'
        assert np.array_equal(frame.image, expected)
    source.rewind()
    assert np.array_equal(source.read().image, decode_clip(1)[0])
    source.close()


def test_video_can_be_a_file_url() -> None:
    source = open_source(f'file://{CLIP}')
    assert source.skip() and not source.live
    assert len(list(frames_of(source))) == CLIP_FRAMES - 1


PICTURES = {
    'mono8.png': ('mono8', (4, 5), np.uint8), 'mono16.png': ('mono16', (4, 5), np.uint16),
    'bgr8.bmp': ('bgr8', (4, 5, 3), np.uint8), 'bgr16.tiff': ('bgr16', (4, 5, 3), np.uint16),
    'bgra8.png': ('bgra8', (4, 5, 4), np.uint8), 'float.tiff': ('32FC1', (4, 5), np.float32),
}


@pytest.mark.parametrize('name', PICTURES)
def test_picture_keeps_its_depth_and_channels(tmp_path: Path, name: str) -> None:
    encoding, shape, dtype = PICTURES[name]
    image = np.random.default_rng(3).integers(0, 255, shape).astype(dtype)
    cv2.imwrite(str(tmp_path / name), image)
    (frame,) = frames_of(open_source(str(tmp_path / name)))
    assert frame.encoding == encoding
    assert np.array_equal(frame.image, image)


@pytest.mark.parametrize('orientation', UPRIGHT)
def test_pictures_are_turned_upright(tmp_path: Path, orientation: int) -> None:
    image = np.random.default_rng(3).integers(0, 255, (16, 24, 3), np.uint8)
    jpeg = oriented_jpeg(image, orientation)
    (tmp_path / 'lying.jpg').write_bytes(jpeg)
    lying = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED)
    for text in (tmp_path, tmp_path / 'lying.jpg'):
        (frame,) = frames_of(open_source(str(text)))
        np.testing.assert_array_equal(frame.image, UPRIGHT[orientation](lying), strict=True)
        assert frame.encoding == 'bgr8'
    width, height = (16, 24) if orientation >= 5 else (24, 16)
    assert expected_size(str(tmp_path)) == (width, height)


def test_pictures_of_every_suffix_are_found(tmp_path: Path) -> None:
    suffixes = ['png', 'jpg', 'jpeg', 'jpe', 'jp2', 'bmp', 'dib', 'tif', 'tiff', 'webp', 'pbm',
                'pgm', 'ppm', 'pnm', 'pxm', 'exr', 'hdr', 'pic', 'sr', 'ras', 'PNG']
    picture = cv2.imencode('.png', np.zeros((2, 2), np.uint8))[1].tobytes()
    for suffix in suffixes:
        (tmp_path / f'picture.{suffix}').write_bytes(picture)
    assert len(list(frames_of(open_source(str(tmp_path))))) == len(suffixes)


def test_a_file_is_closed_once_its_size_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[str] = []
    monkeypatch.setattr(VideoSource, 'close', lambda source: closed.append(source.name))
    assert expected_size(str(CLIP)) == (1280, 720)
    assert closed == [str(CLIP)]


def test_folder_and_glob_are_read_in_natural_order(tmp_path: Path) -> None:
    for number in (10, 9, 1, 2):
        cv2.imwrite(str(tmp_path / f'f{number}.png'), np.full((2, 2), number, np.uint8))
    (tmp_path / 'notes.txt').write_text('no picture')
    (tmp_path / 'folder.png').mkdir()
    for text in (tmp_path, tmp_path / '*', tmp_path / 'f*.png'):
        values = [int(frame.image[0, 0]) for frame in frames_of(open_source(str(text)))]
        assert values == [1, 2, 9, 10]
    assert sorted(map(Path, ('a10', 'a9', 'b', '1')), key=natural_order) == [
        Path('1'), Path('a9'), Path('a10'), Path('b')]


def test_a_broken_picture_is_left_out(tmp_path: Path) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f'{number}.png'), np.full((2, 2), number, np.uint8))
    (tmp_path / '1.png').write_text('no picture')
    source = open_source(str(tmp_path))
    broken: list[BrokenFrameError] = []
    player = play(source, broken.append, rate=100.0)
    assert [int(frame.image[0, 0]) for frame in player.frames()] == [0, 2]
    assert [str(err) for err in broken] == [
        f'{tmp_path}/1.png cannot be read: 10 bytes are not a picture that OpenCV can read']


@pytest.mark.parametrize(('name', 'text'), [
    ('none.mp4', 'No such file or directory'), ('text.mp4', 'cannot be opened as a video'),
    ('empty.mp4', 'cannot be opened as a video'), ('folder', 'no image file in'),
    ('*.png', 'No such file or directory'), ('*.txt', 'no image file in'),
])
def test_files_that_are_no_source(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / 'text.mp4').write_text('hello')
    (tmp_path / 'some.txt').write_text('hello')
    (tmp_path / 'empty.mp4').touch()
    (tmp_path / 'folder').mkdir()
    with pytest.raises(CaptureError, match=text):
        open_source(str(tmp_path / name))


@pytest.mark.parametrize(('text', 'hint'), [
    ('patern', '; did you mean pattern?'), ('Pattern', '; did you mean pattern?'),
    ('pattren:320x240@5', '; did you mean pattern:320x240@5?'),
    ('lantern', ''), ('pat', ''), ('patterns/in.mp4', ''), ('patern/*.png', '')])
def test_a_mistyped_pattern_is_recognised(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, hint: str) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CaptureError) as caught:
        open_source(text)
    assert str(caught.value) == f'{text} cannot be opened: No such file or directory{hint}'


def test_a_file_with_almost_that_name_is_opened(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path('patern').write_text('hello')
    with pytest.raises(CaptureError) as caught:
        open_source('patern')
    assert str(caught.value) == (
        'patern cannot be opened as a video: it is damaged or not a video')


def test_only_devices_that_can_capture_are_listed(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    events: list[str] = []

    class Device:
        """A device whose file contains its capability, or the error of opening it."""

        def __init__(self, path: Path) -> None:
            content = path.read_text()
            if content.isdecimal():
                raise OSError(int(content), 'refused')
            events.append(f'open {path.name}')
            self._name = path.name
            self.can_capture = content == 'video capture'

        def close(self) -> None:
            events.append(f'close {self._name}')

    monkeypatch.setattr(os_errors, 'VideoDevice', Device)
    for name, content in {
            'video0': 'video capture', 'video1': 'metadata capture', 'video2': 'video output',
            'video3': str(errno.EACCES), 'video4': str(errno.EBUSY), 'video5': str(errno.ENOTTY),
            'video10': 'video capture', 'media0': 'video capture'}.items():
        (tmp_path / name).write_text(content)
    (tmp_path / 'video11').symlink_to('gone')
    listed = [path.name for path in os_errors.list_cameras(tmp_path)]
    assert listed == ['video0', 'video3', 'video4', 'video10']
    assert events == [f'{what} {name}' for name in ('video0', 'video1', 'video2', 'video10')
                      for what in ('open', 'close')]
    assert [path.name for path in os_errors.list_cameras(tmp_path)] == listed
    assert len(events) == 8  # an unchanged device is not opened again


@pytest.mark.parametrize(('text', 'reason'), [
    ('987', 'camera /dev/video987 does not exist; cameras on this machine: '),
    ('/dev/v4l/by-id/none', 'camera /dev/v4l/by-id/none does not exist'),
    ('/dev/null', '/dev/null is not a camera'),
])
def test_devices_that_are_no_camera(text: str, reason: str) -> None:
    with pytest.raises(CaptureError, match=reason):
        open_source(text)


@pytest.mark.parametrize(('kind', 'name', 'reason'), [
    ('fifo', 'x.png', 'x.png is a named pipe; give a file or a folder'),
    ('socket', 'x.png', 'x.png is a socket; give a file or a folder'),
    ('socket', 'x.mp4', 'x.mp4 is a socket; give a file or a folder'),
    ('device', 'x.png', 'x.png is not a camera'),
    ('folder', 'x.png', 'no image file in .*x.png')])
def test_what_is_no_file_is_refused_as_a_source(
        tmp_path: Path, kind: str, name: str, reason: str) -> None:
    KINDS[kind][0](tmp_path / name)
    with pytest.raises(CaptureError, match=reason):
        open_source(str(tmp_path / name))


@pytest.mark.parametrize('kind', ['socket', 'device', 'folder'])
def test_what_takes_the_place_of_a_picture_is_left_out(tmp_path: Path, kind: str) -> None:
    for name in ('1.png', '2.png', '3.png'):
        cv2.imwrite(str(tmp_path / name), np.full((2, 2), int(name[0]), np.uint8))
    source = open_source(str(tmp_path))
    (tmp_path / '2.png').unlink()
    KINDS[kind][0](tmp_path / '2.png')
    reasons: list[str] = []
    assert numbers(play(source, lambda err: reasons.append(str(err)), rate=500.0), 9) == [1, 3]
    assert len(reasons) == 1
    assert KINDS[kind][1] in reasons[0]


def test_a_picture_that_is_too_large_is_left_out(tmp_path: Path) -> None:
    (tmp_path / '1.png').touch()
    os.truncate(tmp_path / '1.png', 1 << 42)
    reasons: list[str] = []
    with pytest.raises(CaptureError, match='has no readable frame'):
        list(play(open_source(str(tmp_path)), lambda err: reasons.append(str(err))).frames())
    assert '1.png cannot be read: 1.png is larger than' in reasons[0]


@pytest.mark.parametrize('form', ['{}', 'file://{}'])
def test_a_pipe_is_not_read_before_it_is_shown(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str) -> None:
    def _open(path: str) -> None:
        opened.append(path)
        raise CaptureError('no video')

    opened: list[str] = []
    monkeypatch.setattr('opencv_tools.capture.source.open_video', _open)
    os.mkfifo(tmp_path / 'pipe')
    text = form.format(tmp_path / 'pipe')
    assert expected_size(text) is None
    assert not opened
    with pytest.raises(CaptureError, match='no video'):
        open_source(text)  # because the pipe may contain a video
    assert opened == [str(tmp_path / 'pipe')]


def numbers(player: Player, most: int) -> list[int]:
    return [int(frame.image.flat[0]) for _, frame in zip(range(most), player.frames())]


@pytest.mark.parametrize(('on_end', 'expected'), [
    ('stop', [0, 1, 2]), ('loop', [0, 1, 2, 0, 1, 2, 0]), ('hold', [0, 1, 2, 2, 2, 2, 2])])
def test_end_of_a_source(tmp_path: Path, on_end: str, expected: list[int]) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f'{number}.png'), np.full((2, 2), number, np.uint8))
    settings = {'plays': 0} if on_end == 'loop' else {'on_end': on_end}
    player = play(open_source(str(tmp_path)), rate=500.0, **settings)
    assert numbers(player, 7) == expected


@pytest.mark.parametrize('on_end', ['stop', 'hold'])
def test_a_source_without_one_readable_frame_fails(tmp_path: Path, on_end: str) -> None:
    (tmp_path / '1.png').write_text('no picture')
    player = play(open_source(str(tmp_path)), lambda err: None, rate=100.0, on_end=on_end)
    with pytest.raises(CaptureError, match='has no readable frame'):
        list(player.frames())


@pytest.mark.parametrize(('settings', 'period'), [({}, 1 / 64), ({'rate': 8.0}, 1 / 8)])
def test_a_file_is_played_at_its_rate_or_that_asked_for(
        clock: SteppedClock, settings: dict[str, Any], period: float) -> None:
    player = play(PatternSource(PatternSpec(8, 8, 64.0)), clock=clock, stop=51, **settings)
    shown = [(clock.now, frame.stamp_ns) for frame in player.frames()]
    due = [BEGAN + number * period for number in range(51)]
    assert shown == [(seconds, int(seconds * 1e9)) for seconds in due]


def test_pictures_are_shown_ten_times_a_second(numbered: Source, clock: SteppedClock) -> None:
    shown = [clock.now for _ in play(numbered, clock=clock).frames()]
    assert shown == pytest.approx([BEGAN, BEGAN + 0.1, BEGAN + 0.2, BEGAN + 0.3])


def test_time_that_was_lost_is_not_made_up_for(clock: SteppedClock) -> None:
    pacer = Pacer(clock)
    pacer.advance(0.0625)
    assert not pacer.is_due()
    assert not pacer.is_due(early=0.05)
    assert pacer.is_due(early=0.0625)
    # The frames due at 0.0625, 0.125 and 0.1875 are late; one of them is yielded at once.
    clock.step_to(BEGAN + 0.25)
    assert pacer.is_due()
    pacer.advance(0.0625)
    assert pacer.is_due()
    pacer.advance(0.0625)
    assert pacer.is_due()
    pacer.advance(0.0625)
    assert not pacer.is_due()
    clock.step_to(BEGAN + 0.3125)
    assert pacer.is_due()


def test_a_reader_that_was_late_gets_one_frame_at_once(clock: SteppedClock) -> None:
    shown = []
    for frame in play(PatternSource(PatternSpec(8, 8, 64.0)), clock=clock, stop=6).frames():
        shown.append((64 * (clock.now - BEGAN), 64 * (frame.stamp_ns / 1e9 - BEGAN)))
        if len(shown) == 2:
            clock.step_to(clock.now + 10.5 / 64)
    assert shown == [(0, 0), (1, 1), (11.5, 10.5), (11.5, 11.5), (12.5, 12.5), (13.5, 13.5)]


def test_a_stop_ends_a_wait_at_once(clock: SteppedClock) -> None:
    stopped = Event()
    clock.plan(2.5, stopped.set)
    player = play(PatternSource(PatternSpec(8, 8, 0.125)), stopped=stopped, clock=clock)
    assert len(list(player.frames())) == 1
    assert clock.now == BEGAN + 2.5


def test_the_clock_of_the_system_waits_for_an_event_or_a_time() -> None:
    assert time.monotonic() <= SYSTEM_CLOCK.monotonic() <= time.monotonic()
    event = Event()
    assert not SYSTEM_CLOCK.wait(event, 0.01)
    event.set()
    assert SYSTEM_CLOCK.wait(event, 3600.0)


def test_nothing_is_shown_while_it_is_held_and_nothing_is_lost(clock: SteppedClock) -> None:
    held = Event()
    source = PatternSource(PatternSpec(200, 3, 64.0))
    player = Player(
        source, lambda: PlaybackSettings(stop=20), Event(), held.is_set, pytest.fail, clock)
    stamps, images = [], []
    for frame in player.frames():
        stamps.append(frame.stamp_ns / 1e9 - BEGAN)
        images.append(frame.image)
        if len(stamps) == 10:
            held.set()
            clock.plan(0.5, held.clear)
    gaps = np.diff(stamps)
    assert 0.5 <= gaps[9] < 0.5 + 0.05  # polled 50 times a second
    assert np.delete(gaps, 9) == pytest.approx(1 / 64)
    for number, image in enumerate(images):
        assert np.array_equal(image, draw_pattern(number, 200, 3))
    assert len(images) == 20


class StampedSource(PatternSource):
    """A file source whose frames have positions."""

    def __init__(self, *positions: float) -> None:
        super().__init__(PatternSpec(8, 8, 25.0))
        self._positions = positions

    def read(self) -> Frame | None:
        number = self._number
        if number == len(self._positions):
            return None
        return replace(super().read(), position=self._positions[number])


@pytest.mark.parametrize(('rate', 'gaps'), [
    (0.0, [0.05, 0.2, 0.01, 0.04, 0.05, 0.2, 0.01]), (50.0, [0.02] * 7)])
def test_frames_are_stamped_by_their_own_times_unless_a_rate_is_asked_for(
        clock: SteppedClock, rate: float, gaps: list[float]) -> None:
    source = StampedSource(3.0, 3.05, 3.25, 3.26)  # the second play steps back by 0.26 s
    player = play(source, clock=clock, rate=rate, plays=2)
    shown = [(frame.stamp_ns / 1e9, clock.now) for frame in player.frames()]
    for times in zip(*shown, strict=True):
        assert times == pytest.approx(BEGAN + np.cumsum([0.0, *gaps]))


@pytest.mark.parametrize(('settings', 'expected'), [
    ({'plays': 2}, [0, 1, 2, 3, 0, 1, 2, 3]),
    ({'first': 2}, [2, 3]),
    ({'stop': 2}, [0, 1]),
    ({'first': 1, 'stop': 3, 'plays': 2}, [1, 2, 1, 2]),
    ({'plays': 0, 'stop': 1}, [0] * 9),
    ({'stop': 9}, [0, 1, 2, 3]),
    ({'on_end': 'hold', 'plays': 2}, [0, 1, 2, 3, 0, 1, 2, 3, 3]),
])
def test_part_of_a_file_is_played_as_often_as_asked(
        numbered: Source, settings: dict[str, Any], expected: list[int]) -> None:
    assert numbers(play(numbered, rate=500.0, **settings), 9) == expected


@pytest.mark.parametrize('first', [4, 5, 7])
def test_a_first_frame_that_there_is_not(numbered: Source, first: int) -> None:
    with pytest.raises(CaptureError, match=f'^start_frame is {first}, but .* has only 4 '):
        list(play(numbered, rate=500.0, first=first).frames())


def test_a_first_frame_that_a_video_has_not() -> None:
    with pytest.raises(CaptureError, match=f'has only {CLIP_FRAMES} frames, numbered from 0$'):
        list(play(open_source(str(CLIP)), rate=500.0, first=CLIP_FRAMES).frames())
