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

"""A V4L2 camera as a source."""

from __future__ import annotations

import grp
import os
from pathlib import Path
import stat
import time

import cv2
from opencv_tools.capture.frame import CaptureError, Frame

_V4L2_MAJOR = 81  # Linux, Documentation/admin-guide/devices.txt: video4linux


class CameraSource:
    """A camera's frames, each with the time at which its driver captured it."""

    live = True

    def __init__(self, device: Path) -> None:
        """
        Open a camera.

        :param device: such as ``/dev/video0`` or a link below ``/dev/v4l/by-id``.
        :raises CaptureError: there is no such camera, or it cannot be used.
        """
        self.name = str(device)
        _check_device(device)
        self._capture = cv2.VideoCapture(self.name, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise CaptureError(
                f'camera {self.name} cannot be opened: another program uses it, or this node of '
                'the camera gives no pictures (cameras have several, try the next number)')
        self.rate = max(0.0, self._capture.get(cv2.CAP_PROP_FPS))

    def skip(self) -> bool:
        if not self._capture.grab():
            raise CaptureError(
                f'camera {self.name} stopped giving frames; is it still plugged in?')
        return True

    def read(self) -> Frame:
        self.skip()
        captured_ms = self._capture.get(cv2.CAP_PROP_POS_MSEC)
        now_ns = time.monotonic_ns()
        # The driver's stamp may lie a little ahead of the clock, and may be missing.
        stamp_ns = min(int(captured_ms * 1e6), now_ns) if captured_ms > 0 else now_ns
        decoded, image = self._capture.retrieve()
        if not decoded:
            raise CaptureError(f'camera {self.name} gave a frame that OpenCV cannot decode')
        return Frame(image, 'bgr8', stamp_ns)

    def rewind(self) -> None:
        raise CaptureError(f'camera {self.name} has no first frame to go back to')

    def close(self) -> None:
        self._capture.release()


def _check_device(device: Path) -> None:
    """
    Tell why a camera could not be opened, as far as the file system knows.

    :raises CaptureError: no such device, not a camera, or no permission.
    """
    try:
        status = device.stat()
    except OSError as err:
        present = ', '.join(sorted(str(path) for path in Path('/dev').glob('video*'))) or 'none'
        raise CaptureError(f'there is no camera {device}; cameras on this machine: {present}. '
                           'To try without one: source:=pattern') from err
    if not stat.S_ISCHR(status.st_mode) or os.major(status.st_rdev) != _V4L2_MAJOR:
        raise CaptureError(f'{device} is not a camera')
    if not os.access(device, os.R_OK | os.W_OK):
        raise CaptureError(f'no permission to use camera {device}; add yourself to its group: '
                           f'sudo usermod -aG {_group_name(status.st_gid)} $USER, '
                           'then log in again')


def _group_name(group_id: int) -> str:
    """Name a group; one that has no name, as in some containers, is called by its number."""
    try:
        return grp.getgrgid(group_id).gr_name
    except KeyError:
        return str(group_id)
