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

"""Frames in shared memory: pixels, lifetimes, full memory, hostile headers and announcements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import gc
import json
from pathlib import Path
import subprocess
import sys
from types import ModuleType
from typing import Any

from hypothesis import given, settings, strategies
import numpy as np
from opencv_tools.image.errors import CdrError
from opencv_tools.transport.shared_frames.announcement import (
    announce, AnnouncementError, read_announcement)
from opencv_tools.transport.shared_frames.header import FrameHeader, SharedFrame
from opencv_tools.transport.shared_frames.memory import FrameMemory, MAX_READERS
from opencv_tools.transport.shared_frames.pages import SharedMemoryError
from opencv_tools.transport.shared_frames.reader import FrameReader, MAX_VIEWS
from opencv_tools.transport.shared_frames.writer import FrameWriter
import pytest
from waiting import LONGEST_SECONDS

SERVICE = '0123456789abcdef' * 2


@pytest.fixture(scope='module')
def memory() -> FrameMemory:
    return FrameMemory()


def publish(writer: FrameWriter, pixels: np.ndarray, number: int = 0) -> bool:
    slot = writer.lend(pixels.size)
    slot.data[:] = pixels
    return slot.publish(FrameHeader(number=number, height=1, width=pixels.size), 'câmera', 'mono8')


def receive(reader: FrameReader) -> SharedFrame:
    assert reader.wait(LONGEST_SECONDS)
    frame = reader.receive()
    assert frame is not None
    return frame


def random_pixels(size: int) -> np.ndarray:
    return np.random.default_rng(size).integers(0, 256, size, np.uint8)


@pytest.mark.parametrize('sizes', [
    (1, 1), (921600, 921600), (10, 6220800, 1000, 24883200, 0, 6220800)])
def test_pixels_of_every_size(memory: FrameMemory, sizes: Sequence[int]) -> None:
    writer = memory.create_writer(sizes[0])
    reader = memory.open_reader(writer.service, 4)
    for number, size in enumerate(sizes, 1):
        pixels = random_pixels(size)
        publish(writer, pixels, number)
        frame = receive(reader)
        assert (frame.header.number, frame.header.width) == (number, size)
        assert (frame.frame_id, frame.encoding) == ('câmera', 'mono8')
        assert np.array_equal(frame.data, pixels)


def test_oldest_waiting_frame_is_overwritten(memory: FrameMemory) -> None:
    writer = memory.create_writer(3)
    reader = memory.open_reader(writer.service, 2)
    for number in range(1, 6):
        publish(writer, random_pixels(3), number)
    assert [receive(reader).header.number, reader.receive().header.number] == [4, 5]
    assert reader.receive() is None


def test_frame_for_which_a_reader_has_no_room(memory: FrameMemory) -> None:
    writer = memory.create_writer(3, overwrites=False)
    assert publish(writer, random_pixels(3), 1)  # there is no reader
    small, large = (memory.open_reader(writer.service, depth) for depth in (2, 5))
    assert [publish(writer, random_pixels(3), number) for number in (2, 3)] == [True, True]
    assert [publish(writer, random_pixels(3), 4) for _ in range(2)] == [False, False]
    assert small.receive().header.number == 2
    assert publish(writer, random_pixels(3), 4)
    for reader, numbers in ((small, [3, 4]), (large, [2, 3, 4, 4, 4])):
        assert [reader.receive().header.number for _ in numbers] == numbers
        assert reader.receive() is None
    assert publish(writer, random_pixels(3), 5)
    del small, large, reader
    gc.collect()
    assert publish(writer, random_pixels(3), 6)


def test_several_readers_and_their_count(memory: FrameMemory) -> None:
    writer = memory.create_writer(8)
    readers = [memory.open_reader(writer.service, 1) for _ in range(MAX_READERS)]
    assert writer.readers == MAX_READERS
    with pytest.raises(SharedMemoryError, match=f'it has {MAX_READERS} readers already'):
        memory.open_reader(writer.service, 1)
    publish(writer, random_pixels(8))
    assert all(np.array_equal(receive(reader).data, random_pixels(8)) for reader in readers)
    del readers
    gc.collect()
    assert writer.readers == 0


def test_more_held_frames_are_copies(memory: FrameMemory) -> None:
    writer = memory.create_writer(8)
    reader = memory.open_reader(writer.service, 2)
    held = []
    for number in range(40):
        publish(writer, np.full(8, number, np.uint8))
        held.append(receive(reader))
        assert not held[-1].data.flags.writeable
    assert [int(frame.data[0]) for frame in held] == [*range(40)]
    in_place = [frame.data.base is not None for frame in held]
    assert in_place == [True] * MAX_VIEWS + [False] * (40 - MAX_VIEWS)
    del held[1]
    gc.collect()
    publish(writer, np.full(8, 99, np.uint8))
    assert receive(reader).data.base is not None


def test_frames_while_another_is_released(memory: FrameMemory) -> None:
    writer = memory.create_writer(8)
    reader = memory.open_reader(writer.service, 2)
    received = []

    class Views(set[int]):
        """Views of which the first release receives, as another thread may do then."""

        def discard(self, view: int) -> None:
            super().discard(view)
            if not received:
                received.append(reader.receive())
                received.append(reader.receive())

    reader._views = Views()
    held = []
    for number in range(MAX_VIEWS):
        publish(writer, np.full(8, number, np.uint8))
        held.append(receive(reader))
    for number in (98, 99):
        publish(writer, np.full(8, number, np.uint8))
    del held[0]
    gc.collect()
    assert [int(frame.data[0]) for frame in received if frame] == [98, 99]


def test_view_outlives_reader_and_writer(memory: FrameMemory) -> None:
    writer = memory.create_writer(6)
    reader = memory.open_reader(writer.service, 1)
    pixels = random_pixels(6)
    publish(writer, pixels)
    view = receive(reader).data[2:5]
    assert not view.flags.writeable
    with pytest.raises(ValueError, match='WRITEABLE'):
        view.flags.writeable = True
    del reader
    gc.collect()
    for _ in range(40):  # more than there are slots for one reader
        publish(writer, np.zeros(6, np.uint8))
    assert np.array_equal(view, pixels[2:5])
    del writer
    gc.collect()
    assert np.array_equal(view, pixels[2:5])


def test_reader_without_writer(memory: FrameMemory) -> None:
    with pytest.raises(SharedMemoryError, match='DoesNotExist'):
        memory.open_reader(SERVICE, 1)
    writer = memory.create_writer(6)
    reader = memory.open_reader(writer.service, 1)
    assert reader.has_writer
    del writer
    gc.collect()
    assert not reader.has_writer
    assert not reader.wait(0.01)
    assert reader.receive() is None


@pytest.mark.parametrize('sizes', [(54,), (54,) * 6, (108, 324, 54, 9000), (1, 10**4, 10**6)])
@pytest.mark.parametrize('count', [0, 1], ids=['none received', 'one received'])
@pytest.mark.parametrize('overwrites', [False, True])
def test_frames_before_the_end_of_a_writer(
        memory: FrameMemory, sizes: Sequence[int], count: int, overwrites: bool) -> None:
    writer = memory.create_writer(sizes[0], overwrites=overwrites)
    reader = memory.open_reader(writer.service, 10)
    frames = []
    for number, size in enumerate(sizes):
        publish(writer, random_pixels(size))
        if number < count:
            frames.append(receive(reader))
    writer.end()
    assert not reader.has_writer
    while frame := reader.receive():
        frames.append(frame)
    assert writer.readers == 1
    reader.close()
    assert writer.readers == 0
    del writer
    gc.collect()
    assert [frame.data.size for frame in frames] == [*sizes]
    for frame in frames:
        assert np.array_equal(frame.data, random_pixels(frame.data.size))


any_header = given(
    sizes=strategies.tuples(*[strategies.one_of(
        strategies.integers(0, 30), strategies.integers(0, 2**32 - 1))] * 3),
    payload=strategies.binary(max_size=40))


def check_hostile_header(memory: FrameMemory, sizes: tuple[int, int, int], payload: bytes) -> None:
    writer = memory.create_writer(64)
    reader = memory.open_reader(writer.service, 1)
    slot = writer.lend(len(payload))
    slot.data[:] = np.frombuffer(payload, np.uint8)
    writer.send(slot._sample, FrameHeader(
        data_size=sizes[0], frame_id_size=sizes[1], encoding_size=sizes[2]))
    try:
        frame = receive(reader)
    except CdrError:
        return
    assert frame.data.size == sizes[0]
    assert sum(sizes) <= len(slot._payload)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [20, 60])
def test_hostile_header(examples: int, memory: FrameMemory) -> None:
    settings(max_examples=examples)(any_header(check_hostile_header))(memory=memory)


def test_texts_that_are_too_long(memory: FrameMemory) -> None:
    writer = memory.create_writer(4)
    slot = writer.lend(4)
    with pytest.raises(SharedMemoryError, match=r'frame_id and encoding have 605 bytes'):
        slot.publish(FrameHeader(), 'f' * 600, 'mono8')
    del slot
    publish(writer, random_pixels(4))


def test_missing_iceoryx2(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'iceoryx2', None)
    with pytest.raises(SharedMemoryError, match='iceoryx2 cannot be imported'):
        FrameMemory()


def test_iceoryx2_of_another_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'iceoryx2', ModuleType('iceoryx2'))
    with pytest.raises(SharedMemoryError, match='AttributeError'):
        FrameMemory()


def test_folder_of_others_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / f'opencv_tools_{announce(SERVICE, SERVICE).user}'
    folder.mkdir(mode=0o755)
    with pytest.raises(SharedMemoryError, match='is not a folder that only this user can access'):
        FrameMemory(tmp_path)
    folder.rmdir()
    folder.symlink_to('/tmp')
    with pytest.raises(SharedMemoryError, match='is not a folder that only this user can access'):
        FrameMemory(tmp_path)


FILL = """
import sys
from opencv_tools.transport.shared_frames.header import FrameHeader
from opencv_tools.transport.shared_frames.memory import FrameMemory
from opencv_tools.transport.shared_frames.pages import SharedMemoryError
size, readers = int(sys.argv[1]), int(sys.argv[2])
held, sent = [], 0
try:
    memory = FrameMemory()
    writer = memory.create_writer(size)
    opened = [memory.open_reader(writer.service, 16) for _ in range(readers)]
    for number in range(60):
        slot = writer.lend(size)
        slot.data[:] = number
        slot.publish(FrameHeader(sec=number), '', '')
        sent += 1
        held += [reader.receive() for reader in opened[1:]]
except SharedMemoryError as err:
    print(err)
assert all((frame.data == frame.header.sec).all() for frame in held)
print('sent', sent)
"""


@pytest.mark.quick_cases(2)
@pytest.mark.process
@pytest.mark.parametrize(('megabytes', 'size', 'refused'), [
    (4, 6220800, True), (14, 6220800, True), (32, 6220800, True), (64, 6220800, True),
    (64, 100000, False), (0.3, 1000, True)])
def test_full_shared_memory(mount_namespace: Sequence[str], megabytes: float, size: int,
                            refused: bool) -> None:
    mounted = f'mount -t tmpfs -o size={int(megabytes * 2**20)} none /dev/shm && exec "$@"'
    finished = subprocess.run(
        [*mount_namespace, 'sh', '-c', mounted, 'sh', sys.executable, '-c', FILL, str(size), '3'],
        capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, (finished.returncode, finished.stderr)
    assert ('sent 60' not in finished.stdout) == refused, finished.stdout
    assert ('/dev/shm' in finished.stdout) == refused, finished.stdout


FULL = """
import os, sys
from opencv_tools.transport.shared_frames.header import FrameHeader
from opencv_tools.transport.shared_frames.memory import FrameMemory
from opencv_tools.transport.shared_frames.pages import SharedMemoryError

size, sent_before = int(sys.argv[1]), int(sys.argv[2])
memory = FrameMemory()
writer = memory.create_writer(size)
reader = memory.open_reader(writer.service, 16)
held, sent = [], 0
for number in range(40):
    if number == sent_before:
        found = os.statvfs('/dev/shm')
        with open('/dev/shm/filling', 'wb') as file:
            file.write(bytes(found.f_bavail * found.f_frsize))
    try:
        slot = writer.lend(size)
        slot.data[:] = number
        slot.publish(FrameHeader(sec=number), '', '')
        sent += 1
    except SharedMemoryError as err:
        assert '/dev/shm' in str(err)
    if number % 3 == 0:
        held.append(reader.receive())
assert all((frame.data == frame.header.sec).all() for frame in held if frame)
print(sent)
"""


@pytest.mark.quick_cases(3)
@pytest.mark.process
@pytest.mark.parametrize('size', [3500, 4096, 10000])
@pytest.mark.parametrize('sent_before', [2, 5, 7])
def test_shared_memory_filled_by_others(
        mount_namespace: Sequence[str], size: int, sent_before: int) -> None:
    finished = subprocess.run(
        [*mount_namespace, 'sh', '-c', 'mount -t tmpfs -o size=8m none /dev/shm && exec "$@"',
         'sh', sys.executable, '-c', FULL, str(size), str(sent_before)],
        capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, (finished.returncode, finished.stderr)
    assert sent_before <= int(finished.stdout) < 40


# Announcements

def test_announcement_there_and_back() -> None:
    announcement = announce(SERVICE, SERVICE)
    assert announcement.is_reachable
    assert read_announcement(announcement.to_text()) == announcement
    assert not replace(announcement, service='').is_reachable


@pytest.mark.parametrize('changed', [
    {'boot': '0' * 36}, {'memory': -1}, {'user': 2**40}])
def test_announcement_of_another_place(changed: dict[str, Any]) -> None:
    text = json.dumps({**json.loads(announce(SERVICE, SERVICE).to_text()), **changed})
    assert not read_announcement(text).is_reachable


@pytest.mark.parametrize(('text', 'reason'), [
    ('', 'is not JSON'), ('[' * 4000, 'is not JSON'), ('x' * 5000, 'the limit is 4096'),
    ('[]', 'does not have version 2'), ('{"version": 1}', 'does not have version 2'),
    ('{"version": 2, "service": "../../x"}', 'invalid service'),
    ('{"version": 2, "service": "", "boot": 7}', 'invalid boot'),
    ('{"version": 2, "service": "", "boot": "a", "memory": true, "user": 0}', 'invalid memory'),
    (json.dumps({**json.loads(announce(SERVICE, SERVICE).to_text()), 'frames': 1, 'messages': 2}),
     'invalid numbers of frames')])
def test_malformed_announcements(text: str, reason: str) -> None:
    with pytest.raises(AnnouncementError, match=reason):
        read_announcement(text)


any_announcement = given(
    strategies.one_of(strategies.text(), strategies.recursive(
        strategies.one_of(strategies.none(), strategies.integers(), strategies.text()),
        lambda inner: strategies.dictionaries(strategies.sampled_from(
            ('version', 'service', 'boot', 'memory', 'user')), inner)).map(json.dumps)))


def check_hostile_announcements(text: str) -> None:
    try:
        read_announcement(text)
    except AnnouncementError as err:
        assert str(err)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [50, 200])
def test_hostile_announcements(examples: int) -> None:
    settings(max_examples=examples)(any_announcement(check_hostile_announcements))()
