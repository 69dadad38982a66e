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

"""Calibration files as CameraInfo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from opencv_tools.calibration.camera_file import (
    CameraInfoError, check_camera_name, ImageRegion, read_camera, StoredCamera, write_camera)
from sensor_msgs.msg import CameraInfo, RegionOfInterest

__all__ = ['CameraInfoError', 'check_camera_name', 'read_camera_info', 'write_camera_info']


def read_camera_info(
    path: Path, warn: Callable[[str], object] = lambda _: None,
) -> CameraInfo:
    """
    Read a calibration file of camera_calibration or camera_calibration_parsers.

    :param warn: called with a sentence for each assumption about a missing value.
    :returns: the calibration, with an empty header.
    :raises CameraInfoError: the file cannot be read or has another format.
    """
    fields = asdict(read_camera(path, warn))
    return CameraInfo(**{**fields, 'roi': RegionOfInterest(**fields['roi'])})


def write_camera_info(
    path: Path, info: CameraInfo, name: str, ros_home: Path | None = None,
) -> None:
    """
    Write a calibration atomically, in the exact format of camera_calibration_parsers.

    An existing file is replaced only if it is a calibration.

    :param info: calibration to write.
    :param ros_home: folder below which missing folders are created; None for none.
    :raises CameraInfoError: the calibration is invalid, the existing file is not a calibration,
        or the file cannot be written.
    """
    matrices = {key: tuple(map(float, getattr(info, key))) for key in ('d', 'k', 'r', 'p')}
    region = {key: getattr(info.roi, key) for key in (
        'x_offset', 'y_offset', 'height', 'width', 'do_rectify')}
    write_camera(path, StoredCamera(
        width=info.width, height=info.height, distortion_model=info.distortion_model,
        binning_x=info.binning_x, binning_y=info.binning_y, roi=ImageRegion(**region),
        **matrices), name, ros_home)
