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


"""Space that recordings leave on the disk."""

from __future__ import annotations

from pathlib import Path
import shutil
from threading import Event

from console import Console
from opencv_tools.bags.open_bag import Bag
from opencv_tools.recording import file_sink as module
from opencv_tools.recording.errors import LimitReached
from opencv_tools.recording.open_sink import open_bag_sink
from opencv_tools.recording.recorder import Recorder
import pytest
from recordings import gray_frame
from waiting import wait_until


def test_end_at_the_reserve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sink, is_written, ended = open_bag_sink(tmp_path, 'drive'), Event(), []
    recorder = Recorder(sink, Console(), writers=1, on_full=lambda: ended.append(True))
    for number in range(2):
        recorder.put(gray_frame(number))
    recorder.put(gray_frame(2), lambda outcome: is_written.set())
    wait_until(is_written.is_set)
    assert 0 < sink.left <= shutil.disk_usage(tmp_path).total
    monkeypatch.setattr(module, 'RESERVE_BYTES', 10**18)
    for number in range(3):
        recorder.put(gray_frame(number))
    recorder.close()
    assert (recorder.counts.written, recorder.counts.skipped, recorder.counts.failed) == (3, 3, 0)
    assert ended == [True]
    assert recorder.limit.endswith(' MB left, and recordings leave 1000000000000 MB free')
    assert sum(Bag(tmp_path / 'drive.mcap').topics.values()) == 3


def test_removed_folder(tmp_path: Path) -> None:
    folder = tmp_path / 'bags'
    sink = open_bag_sink(folder, 'drive')
    shutil.rmtree(folder)
    sink.check_reserve()
    assert sink.left is None
    frame = gray_frame(1)
    path = sink.commit(frame, sink.prepare(frame))  # which creates the folder again
    sink.check_reserve()
    sink.close()
    assert path.exists() and sink.left


def test_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, 'RESERVE_BYTES', 10**18)
    sink = open_bag_sink(tmp_path, 'drive')
    with pytest.raises(LimitReached, match=r'the disk has .* MB left'):
        sink.check_reserve()
    sink.close()
    assert [*tmp_path.iterdir()] == []
