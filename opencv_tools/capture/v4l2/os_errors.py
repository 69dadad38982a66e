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

"""Errors of cameras in plain words, and the list of cameras on this machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
import errno
from functools import lru_cache
import grp
import os
from pathlib import Path
import stat

from opencv_tools.capture.errors import CaptureError, UnavailableError
from opencv_tools.capture.v4l2.device import VideoDevice
from opencv_tools.capture.v4l2.videodev2 import VIDEO_MAJOR
from opencv_tools.image.text import printable
from opencv_tools.regular_files import natural_order


@contextmanager
def capture_errors(name: str) -> Iterator[None]:
    """
    Convert each OSError of a device to a CaptureError with a remedy.

    :param name: path of the device, for the message.
    :raises UnavailableError: the camera is disconnected, busy, or the user has no permission.
    :raises CaptureError: the device is not a camera.
    """
    try:
        yield
    except OSError as err:
        raise _to_capture_error(name, err) from err


def check_device(device: Path) -> None:
    """
    Check that a path is a V4L2 device.

    :param device: path of the device.
    :raises UnavailableError: the path does not exist.
    :raises CaptureError: the path is another kind of file.
    """
    try:
        status = device.stat()
    except OSError as err:
        raise UnavailableError(
            f'camera {device} does not exist; cameras on this machine: {_present()}. '
            'To run without a camera: source:=pattern') from err
    if not stat.S_ISCHR(status.st_mode) or os.major(status.st_rdev) != VIDEO_MAJOR:
        raise CaptureError(f'{device} is not a camera; cameras on this machine: {_present()}')


def _present() -> str:
    """Return the cameras of this machine as text."""
    return ', '.join(map(str, list_cameras())) or 'none'


def list_cameras(folder: Path = Path('/dev')) -> list[Path]:
    """
    Return the devices that can capture video.

    A device that cannot be opened, for example for lack of permission, is included.

    :param folder: folder of the devices.
    :returns: paths in natural order: ``video2`` before ``video10``.
    """
    cameras = []
    for path in sorted(folder.glob('video*'), key=natural_order):
        with suppress(OSError):  # the device was removed after the listing
            if _can_capture(path, path.stat().st_ctime_ns):
                cameras.append(path)
    return cameras


# Cached, because opening another camera can wake that camera up, and the publisher lists the
# cameras repeatedly while its own is disconnected.
@lru_cache(maxsize=64)
def _can_capture(path: Path, _changed_ns: int) -> bool:
    """
    Return whether a device can capture video; True for a device that cannot be opened.

    :param _changed_ns: change time of the device in nanoseconds; a new device has a new one.
    """
    try:
        with closing(VideoDevice(path)) as device:
            return device.can_capture
    except OSError as err:
        return err.errno != errno.ENOTTY


def _to_capture_error(name: str, err: OSError) -> CaptureError:
    """Convert an OSError of a camera to a CaptureError that says the cause and the remedy."""
    if err.errno in (errno.EACCES, errno.EPERM):
        return UnavailableError(
            f'no permission to use camera {name}; add yourself to its group: '
            f'sudo usermod -aG {_group_name(name)} $USER, then log in again')
    if err.errno == errno.EBUSY:
        return UnavailableError(f'camera {name} is used by another program{_users(name)}')
    if err.errno in (errno.ENODEV, errno.ENXIO, errno.ENOENT):
        return UnavailableError(f'camera {name} is disconnected; check that it is plugged in')
    if err.errno == errno.ENOTTY:
        return CaptureError(f'{name} is not a V4L2 camera; cameras on this machine: {_present()}')
    return UnavailableError(f'camera {name} failed: {err.strerror or err}')


def _group_name(name: str) -> str:
    """Return the group of a device; its number if it has no name, as in some containers."""
    try:
        number = Path(name).stat().st_gid
        return grp.getgrgid(number).gr_name
    except OSError:
        return 'video'
    except KeyError:
        return str(number)


def _users(name: str) -> str:
    """Return the programs that have a device open, as far as this user can see them."""
    try:
        device = Path(name).stat().st_rdev
    except OSError:
        return ''
    users = []
    for process in Path('/proc').glob('[0-9]*'):
        try:
            held = any(file.stat().st_rdev == device for file in (process / 'fd').iterdir())
            if held and process.name != str(os.getpid()):
                command = (process / 'comm').read_text(errors='replace')
                users.append(f'{printable(command.strip())} (pid {process.name})')
        except OSError:
            continue  # the process has ended, or belongs to another user
    return f': {", ".join(users)}' if users else ''
