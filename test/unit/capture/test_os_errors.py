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

"""Errors of devices in plain words, and the list of cameras."""

from __future__ import annotations

import errno
from pathlib import Path

from opencv_tools.capture.errors import CaptureError
from opencv_tools.capture.source import open_source
from opencv_tools.capture.v4l2 import camera
import pytest


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

    monkeypatch.setattr(camera, 'VideoDevice', Device)
    for name, content in {
            'video0': 'video capture', 'video1': 'metadata capture', 'video2': 'video output',
            'video3': str(errno.EACCES), 'video4': str(errno.EBUSY), 'video5': str(errno.ENOTTY),
            'video10': 'video capture', 'media0': 'video capture'}.items():
        (tmp_path / name).write_text(content)
    (tmp_path / 'video11').symlink_to('gone')
    listed = [path.name for path in camera.list_cameras(tmp_path)]
    assert listed == ['video0', 'video3', 'video4', 'video10']
    assert events == [f'{what} {name}' for name in ('video0', 'video1', 'video2', 'video10')
                      for what in ('open', 'close')]
    assert [path.name for path in camera.list_cameras(tmp_path)] == listed
    assert len(events) == 8  # an unchanged device is not opened again


@pytest.mark.parametrize(('text', 'reason'), [
    ('987', 'camera /dev/video987 does not exist; cameras on this machine: '),
    ('/dev/v4l/by-id/none', 'camera /dev/v4l/by-id/none does not exist'),
    ('/dev/null', '/dev/null is not a camera'),
])
def test_paths_that_are_not_cameras_are_refused(text: str, reason: str) -> None:
    with pytest.raises(CaptureError, match=reason):
        open_source(text)
