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

"""The YAML files in which camera_calibration and its like keep a calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
import os
from pathlib import Path
import re
import reprlib
from typing import Any, TypeVar

from opencv_tools.regular_files import read_regular, RefusedFileError, replace_file
from sensor_msgs.msg import CameraInfo, RegionOfInterest
import yaml

_T = TypeVar('_T')

_UINT32_MAX = 2**32 - 1
# Words of YAML 1.1 for a truth, each also capitalised and in capitals.
_TRUTH = {form(word): truth for truth, words in (
    (True, ('y', 'yes', 'true', 'on')), (False, ('n', 'no', 'false', 'off')))
    for word in words for form in (str.lower, str.capitalize, str.upper)}

# One has less than 2 KB.
_FILE_BYTES = 1 << 16
_USUAL_MODEL = 'plumb_bob'
_MODEL = re.compile('[A-Za-z0-9_]{0,64}')
_NAME = re.compile('[A-Za-z0-9_.-]{1,128}')

# Key of the file to field of the message, rows and columns; distortion has any number of both.
_MATRICES = {
    'camera_matrix': ('k', 3, 3),
    'distortion_coefficients': ('d', None, None),
    'rectification_matrix': ('r', 3, 3),
    'projection_matrix': ('p', 3, 4),
}


class CameraInfoError(ValueError):
    """A calibration that cannot be used; the message says where, what is wrong and what to do."""


def check_camera_name(name: str) -> None:
    """
    Check that a name of a camera can be part of a path.

    :raises ValueError: it cannot.
    """
    if not _NAME.fullmatch(name) or not name.strip('.'):
        raise ValueError("give up to 128 letters, digits, '_', '-' and '.'")


def read_camera_info(
    path: Path, warn: Callable[[str], object] = lambda _: None,
) -> CameraInfo:
    """
    Read a calibration as camera_calibration and camera_calibration_parsers write it, in YAML.

    :param path: the file.
    :param warn: told in one sentence what the file lacks and is assumed.
    :returns: the calibration, with an empty header.
    :raises CameraInfoError: it cannot be read, or is not what those write.
    """
    try:
        content = read_regular(path, _FILE_BYTES)
    except (OSError, ValueError) as err:  # ValueError: no file has such a name
        raise CameraInfoError(f'{path} cannot be read: {getattr(err, "strerror", err)}; calibrate '
                              'the camera with camera_calibration, or give another URL') from err
    return _parse(content, path, warn)


def write_camera_info(
    path: Path, info: CameraInfo, name: str, ros_home: Path | None = None,
) -> None:
    """
    Write a calibration as camera_calibration_parsers does, to the last bit.

    The file appears whole or not at all. A file is only replaced by its like.

    :param path: the file, which is missing or a calibration.
    :param info: the calibration.
    :param name: the camera's name.
    :param ros_home: a folder; below it the folder of the file is made when it is missing.
    :raises CameraInfoError: it could not be read again, something else is in its place, or the
        file cannot be written.
    """
    try:
        check_camera_name(name)
    except ValueError as err:
        raise CameraInfoError(f'the name of the camera is {name!r:.80}: {err}') from err
    content = yaml.safe_dump(
        _describe(info, name), sort_keys=False, default_flow_style=None, width=math.inf).encode()
    if len(content) > _FILE_BYTES:
        raise CameraInfoError(f'the calibration has {len(content)} bytes: '
                              f'give one of up to {_FILE_BYTES}')
    _parse(content, path)
    try:
        if os.path.lexists(path):
            _check_replaceable(path)
        elif ros_home and '..' not in path.parts and path.is_relative_to(ros_home):
            path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, content)
    except CameraInfoError:
        raise
    except (OSError, ValueError) as err:
        remedy = 'make its folder' if isinstance(err, FileNotFoundError) else 'make it writable'
        raise CameraInfoError(f'{path} cannot be written: {getattr(err, "strerror", err)}; '
                              f'{remedy}, or give another URL') from err


def _check_replaceable(path: Path) -> None:
    """
    Check that a file is a calibration.

    :raises CameraInfoError: it is none, and nobody meant it to be replaced.
    """
    try:
        _parse(read_regular(path, _FILE_BYTES, follow=False), path)
    except (CameraInfoError, RefusedFileError) as err:
        reason = getattr(err, 'strerror', 'there is a file that is no calibration')
        raise CameraInfoError(f'{path} cannot be written: {reason}; '
                              'remove it, or give another URL') from err


@dataclass(frozen=True)
class _Document:
    """What a file holds; a value that is wrong is refused by the file's name and its own."""

    path: Path
    root: Any

    def get(
        self, key: str, convert: Callable[[Any], _T], wanted: str, default: str | None = None,
    ) -> _T:
        value = self.root
        for part in key.split('.'):
            value = value.get(part, default) if isinstance(value, dict) else None
        try:
            return convert(value)
        except (KeyError, TypeError, ValueError) as err:
            found = 'missing' if value is None else reprlib.repr(value)
            raise CameraInfoError(f'{self.path}: {key} is {found}: give {wanted}') from err

    def whole(
        self, key: str, lowest: int = 0, highest: int = _UINT32_MAX, default: str | None = None,
    ) -> int:
        def _convert(value: Any) -> int:
            number = int(value, 16) if str(value)[:2].lower() == '0x' else int(value)
            if not lowest <= number <= highest:
                raise ValueError
            return number

        wanted = f'a whole number from {lowest} to {highest}' if lowest < highest else str(lowest)
        return self.get(key, _convert, wanted, default)

    def matrix(self, key: str, rows: int | None, cols: int | None) -> list[float]:
        size = 1
        for side, count in ((f'{key}.rows', rows), (f'{key}.cols', cols)):
            size *= self.whole(side) if count is None else self.whole(side, count, count)

        def _convert(data: Any) -> list[float]:
            if not isinstance(data, list) or len(data) != size:
                raise TypeError
            numbers = [float(number) for number in data]
            if not all(map(math.isfinite, numbers)):
                raise ValueError
            return numbers

        return self.get(f'{key}.data', _convert, f'a list of {size} finite numbers')


def _parse(
    content: bytes, path: Path, warn: Callable[[str], object] = lambda _: None,
) -> CameraInfo:
    try:
        # Every scalar comes as text, as yaml-cpp has it. By the rules that yaml.safe_load follows
        # the 1e-05 that yaml-cpp writes is no number.
        document = _Document(path, yaml.load(content, yaml.BaseLoader))
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as err:
        mark = getattr(err, 'problem_mark', None)
        line = f' in line {mark.line + 1}' if mark else ''
        raise CameraInfoError(
            f'{path} is no YAML{line}: give the file that camera_calibration writes') from err
    info = CameraInfo(
        width=document.whole('image_width', 1), height=document.whole('image_height', 1),
        distortion_model=document.get(
            'distortion_model', _check_model, 'a text like plumb_bob', _USUAL_MODEL),
        binning_x=document.whole('binning_x', default='0'),
        binning_y=document.whole('binning_y', default='0'),
        **{field: document.matrix(key, *size) for key, (field, *size) in _MATRICES.items()})
    if 'distortion_model' not in document.root:
        warn(f'{path} has no distortion_model: {_USUAL_MODEL} is assumed')
    if 'roi' in document.root:
        left = document.whole('roi.x_offset', 0, info.width)
        top = document.whole('roi.y_offset', 0, info.height)
        info.roi = RegionOfInterest(
            x_offset=left, y_offset=top,
            width=document.whole('roi.width', 0, info.width - left),
            height=document.whole('roi.height', 0, info.height - top),
            do_rectify=document.get('roi.do_rectify', _TRUTH.__getitem__, 'true or false'))
    return info


def _check_model(value: Any) -> str:
    if not isinstance(value, str) or not _MODEL.fullmatch(value):
        raise ValueError
    return value


def _describe(info: CameraInfo, name: str) -> dict[str, Any]:
    """Lay a calibration out as camera_calibration_parsers does, in its order."""

    def _matrix(rows: int, cols: int, data: Any) -> dict[str, Any]:
        return {'rows': rows, 'cols': cols, 'data': [float(number) for number in data]}

    return {
        'image_width': info.width,
        'image_height': info.height,
        'camera_name': name,
        'camera_matrix': _matrix(3, 3, info.k),
        'distortion_model': info.distortion_model,
        'distortion_coefficients': _matrix(1, len(info.d), info.d),
        'rectification_matrix': _matrix(3, 3, info.r),
        'projection_matrix': _matrix(3, 4, info.p),
        'binning_x': info.binning_x,
        'binning_y': info.binning_y,
        'roi': {field: getattr(info.roi, field)
                for field in ('x_offset', 'y_offset', 'height', 'width', 'do_rectify')},
    }
