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

"""Frames of a video whose recording was killed."""

from __future__ import annotations

import os
from pathlib import Path
import sys

import cv2
from opencv_tools.recording.video.writer import count_frames
import pytest
from videos import every_format, record, START_NS


@every_format
def test_frames_of_a_file_truncated_anywhere_are_counted(tmp_path: Path, suffix: str) -> None:
    path, copy = tmp_path / f'video{suffix}', tmp_path / f'cut{suffix}'
    record(path, {number: START_NS + number * 50_000_000 for number in range(60)})
    data = path.read_bytes()
    for size in range(0, len(data), len(data) // 40):
        copy.write_bytes(data[:size])
        capture = cv2.VideoCapture(str(copy))
        played = 0
        while capture.read()[0]:
            played += 1
        assert (count_frames(copy) or 0) == played
    assert played >= 40


def test_unreadable_file_is_not_reported_as_empty(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text, large = tmp_path / 'notes.txt', tmp_path / 'video.mkv'
    text.write_text('precious')
    large.touch()
    os.truncate(large, 8193)  # an MP4 truncated in a header cannot be opened either
    assert count_frames(text) is count_frames(large) is None
    os.truncate(large, 8192)
    assert count_frames(large) == 0
    monkeypatch.setitem(sys.modules, 'av', None)
    assert count_frames(large) is None
