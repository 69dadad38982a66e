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

"""What is published of a camera's calibration: found, scaled and turned as the pictures are."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
import copy
from functools import lru_cache, partial
import math
import os
from pathlib import Path
import re
from threading import Lock

from ament_index_python.packages import get_package_share_directory
import numpy as np
from opencv_tools.image.orientation import turned_axes
from opencv_tools.ros.calibration_file import (
    CameraInfoError, read_camera_info, write_camera_info,
)
from opencv_tools.ros.turned_camera_info import turn_camera_info
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

DEFAULT_URL = 'file://${ROS_HOME}/camera_info/${NAME}.yaml'

_ASPECT_TOLERANCE = 0.01


def ros_home() -> Path:
    """
    Find the folder in which ROS keeps what belongs to a user.

    :raises RuntimeError: there is no home folder.
    """
    return Path(os.environ.get('ROS_HOME') or Path('~/.ros').expanduser())


def resolve_url(url: str, name: str) -> Path:
    """
    Find the file that a calibration URL means, as camera_info_manager does.

    :param url: ``file:///path``, ``package://package/path`` or a path; ``${NAME}`` and
        ``${ROS_HOME}`` are replaced.
    :param name: the camera's name.
    :returns: the file, which need not exist.
    :raises CameraInfoError: the URL means no file.
    """

    def _value(variable: re.Match[str]) -> str:
        if variable[0] == '${NAME}':
            return name
        if variable[0] == '${ROS_HOME}':
            return str(ros_home())
        raise CameraInfoError(f'calibration URL {url!r} has the unknown variable {variable[0]}: '
                              'there are ${NAME} and ${ROS_HOME}')

    try:
        resolved = re.sub(r'\$\{[^}]*\}?', _value, url)
        scheme, separator, place = resolved.partition('://')
        if not separator:
            return Path(resolved).expanduser()
    except RuntimeError as err:
        raise CameraInfoError(
            f'calibration URL {url!r} needs a home folder: write the whole path') from err
    if scheme.lower() == 'file' and place.startswith('/'):
        return Path(place)
    package, *inside = place.split('/')
    if scheme.lower() != 'package' or not package or not inside:
        raise CameraInfoError(f'calibration URL {url!r} means {resolved!r}: '
                              'give file:///PATH, package://PACKAGE/PATH or a path')
    if {'', '.', '..'} & set(inside):
        raise CameraInfoError(f'calibration URL {url!r} means {resolved!r}, which leads out of '
                              "the package: give package://PACKAGE/PATH without '..' and '//'")
    try:
        return Path(get_package_share_directory(package), *inside)
    except (LookupError, OSError, ValueError) as err:  # OSError: there is no AMENT_PREFIX_PATH
        raise CameraInfoError(f'calibration URL {url!r} names the unknown package {package}: '
                              'source the workspace that has it') from err


def scale_camera_info(info: CameraInfo, width: int, height: int) -> CameraInfo:
    """
    Convert a calibration to another size of the same picture.

    The rows of K and P are multiplied by the ratios of the sizes, without a shift by half a pixel,
    as ``PinholeCameraModel::fromCameraInfo`` of image_geometry does for binning. D and R do not
    depend on the size. A region of interest grows to whole pixels.

    :param info: the calibration.
    :param width: of the pictures, in pixels.
    :param height: of the pictures, in pixels.
    :returns: a copy for that size.
    :raises CameraInfoError: the aspect ratios differ by more than 1 %; whether such a picture was
        cropped or stretched nobody can tell.
    """
    same_aspect = math.isclose(
        width * info.height, height * info.width, rel_tol=_ASPECT_TOLERANCE)
    if min(width, height, info.width, info.height) < 1 or not same_aspect:
        raise CameraInfoError(
            f'a calibration for {info.width}x{info.height} cannot be scaled to pictures of '
            f'{width}x{height}: calibrate the camera at that size')
    scaled = copy.deepcopy(info)
    scaled.width, scaled.height = width, height
    ratios = (width / info.width, height / info.height, 1.0)
    scaled.k = info.k * np.repeat(ratios, 3)
    scaled.p = info.p * np.repeat(ratios, 4)
    roi = scaled.roi
    roi.x_offset, roi.width = _scale_span(roi.x_offset, roi.width, width, info.width)
    roi.y_offset, roi.height = _scale_span(roi.y_offset, roi.height, height, info.height)
    return scaled


class Calibration:
    """
    What a node publishes as ``camera_info``.

    The file has that of the camera's own pictures, neither flipped nor rotated. One that cannot
    be loaded is warned about, and the camera then counts as uncalibrated. ``save``
    may run beside ``message``.

    :param url: where it is, see ``resolve_url``; '' for ``DEFAULT_URL``, where none need be.
    :param name: the camera's name.
    :param warn: told in one sentence what is wrong.
    """

    def __init__(self, url: str, name: str, warn: Callable[[str], object]) -> None:
        self._name = name
        self._warn = warn
        self._saving = Lock()
        self._ros_home: Path | None = None
        self._path: Path | None = None
        self._refusal = ''
        with suppress(RuntimeError):  # there is no home folder
            self._ros_home = ros_home()
        info = None
        try:
            # Found once: nothing that changes later decides which file is written.
            self._path = resolve_url(url or DEFAULT_URL, name)
            info = read_camera_info(self._path, warn)
        except CameraInfoError as err:
            self._refusal = str(err)
            if url or not isinstance(err.__cause__, FileNotFoundError):
                warn(f'{err}; camera_info is published uncalibrated')
        self._use(info)

    def message(
        self, header: Header, width: int, height: int, flip: str = 'none', rotate: int = 0,
    ) -> CameraInfo:
        """
        Make the message that goes with a picture.

        :param header: of the picture.
        :param width: of the picture, in pixels.
        :param height: of the picture, in pixels.
        :param flip: how the picture was mirrored, see ``orient``.
        :param rotate: degrees that it was turned clockwise, see ``orient``.
        :returns: a new message; all zero but for header and size when there is no calibration for
            that picture, as sensor_msgs/CameraInfo has it.
        """
        message = copy.deepcopy(self._fitted(width, height, flip, rotate))
        message.header = header
        return message

    def save(self, info: CameraInfo, flip: str = 'none', rotate: int = 0) -> str:
        """
        Write a new calibration to the URL's file and use it from now on.

        The file has the calibration of the camera itself, neither flipped nor rotated.

        :param info: what service ``set_camera_info`` was sent, for pictures as they are published.
        :param flip: how these are mirrored, see ``orient``.
        :param rotate: degrees that these are turned clockwise, see ``orient``.
        :returns: the path of the file.
        :raises CameraInfoError: it cannot be written; the previous one stays in use.
        """
        with self._saving:  # what is in the file and what is published are the same
            if self._path is None:
                raise CameraInfoError(self._refusal)
            own = turn_camera_info(info, turned_axes(flip, rotate).T)
            write_camera_info(self._path, own, self._name, self._ros_home)
            self._use(read_camera_info(self._path))
        return str(self._path)

    def _use(self, info: CameraInfo | None) -> None:
        # The calibration and what was made of it change as one, under the feet of message().
        self._fitted = lru_cache(maxsize=None)(partial(self._fit, info))

    def _fit(
        self, info: CameraInfo | None, width: int, height: int, flip: str, rotate: int,
    ) -> CameraInfo:
        if info is not None:
            try:
                size = (height, width) if rotate % 180 else (width, height)
                return turn_camera_info(
                    scale_camera_info(info, *size), turned_axes(flip, rotate))
            except CameraInfoError as err:
                self._warn(f'{err}; camera_info is published uncalibrated')
        return CameraInfo(width=width, height=height)


def _scale_span(start: int, length: int, size: int, old_size: int) -> tuple[int, int]:
    """Scale a part of a side to all pixels that it touches, so that it is never lost."""
    first = start * size // old_size
    last = -(-(start + length) * size // old_size)
    return first, last - first
