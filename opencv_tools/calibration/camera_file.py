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

"""Calibration files in the YAML and INI formats of camera_calibration_parsers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import math
import os
from pathlib import Path
import re
import reprlib
from typing import Any, TypeVar

from opencv_tools.base.regular_files import read_regular, RefusedFileError, replace_file
import yaml

_T = TypeVar('_T')

_UINT32_MAX = 2**32 - 1
# Boolean words of YAML 1.1, each also capitalised and in capitals.
_BOOLEANS = {form(word): truth for truth, words in (
    (True, ('y', 'yes', 'true', 'on')), (False, ('n', 'no', 'false', 'off')))
    for word in words for form in (str.lower, str.capitalize, str.upper)}

# Maximum size of a file; a calibration has less than 2 KB.
_FILE_BYTES = 1 << 16
_DEFAULT_MODEL = 'plumb_bob'
# Distortion models by camera_model, which some drivers write instead of distortion_model.
_CAMERA_MODELS = {'': _DEFAULT_MODEL, 'pinhole': _DEFAULT_MODEL, 'fisheye': 'equidistant',
                  'equidistant': 'equidistant', 'kannala_brandt': 'equidistant'}
# First line of a file that OpenCV has written, which is no directive of YAML.
_OPENCV_YAML = re.compile(rb'\A%YAML:1\.\d\s*\n')
# A file of cameracalibrator: keys, each before its numbers, in sections.
_INI = re.compile(rb'^\[image\]\s*$', re.MULTILINE)
_INI_MATRICES = {'camera matrix': 'camera_matrix', 'distortion': 'distortion_coefficients',
                 'rectification': 'rectification_matrix', 'projection': 'projection_matrix'}
_MODEL = re.compile('[A-Za-z0-9_]{0,64}')
_NAME = re.compile('[A-Za-z0-9_.-]{1,128}')

# Field of StoredCamera, rows and columns by key of the file. Distortion has any size.
_MATRICES = {
    'camera_matrix': ('k', 3, 3),
    'distortion_coefficients': ('d', None, None),
    'rectification_matrix': ('r', 3, 3),
    'projection_matrix': ('p', 3, 4),
}


class CameraInfoError(ValueError):
    """A calibration cannot be used; the message names the file, the problem and the remedy."""


@dataclass(frozen=True, kw_only=True)
class ImageRegion:
    """Region of interest of CameraInfo, in pixels."""

    x_offset: int = 0
    y_offset: int = 0
    height: int = 0
    width: int = 0
    do_rectify: bool = False


@dataclass(frozen=True, kw_only=True)
class StoredCamera:
    """
    The content of a calibration file, with the fields of CameraInfo.

    :param width: width of the images in pixels.
    :param height: height of the images in pixels.
    :param distortion_model: name of the model of ``d``.
    :param k: camera matrix, 9 numbers in rows.
    :param r: rotation of the rectification, 9 numbers in rows.
    :param p: projection matrix of the rectified image, 12 numbers in rows.
    :param binning_x: pixels of the sensor in a pixel of the image.
    :param binning_y: the same for rows.
    """

    width: int
    height: int
    distortion_model: str
    d: tuple[float, ...]
    k: tuple[float, ...]
    r: tuple[float, ...]
    p: tuple[float, ...]
    binning_x: int = 0
    binning_y: int = 0
    roi: ImageRegion = field(default_factory=ImageRegion)


def check_camera_name(name: str) -> None:
    """
    Check that a camera name can be part of a path.

    :raises ValueError: it cannot.
    """
    if not _NAME.fullmatch(name) or not name.strip('.'):
        raise ValueError("give up to 128 letters, digits, '_', '-' and '.'")


def read_camera(
    path: Path, warn: Callable[[str], object] = lambda _: None,
) -> StoredCamera:
    """
    Read a calibration file of camera_calibration or camera_calibration_parsers.

    :param warn: called with a sentence for each assumption about a missing value.
    :returns: the calibration.
    :raises CameraInfoError: the file cannot be read or has another format.
    """
    try:
        content = read_regular(path, _FILE_BYTES)
    except (OSError, ValueError) as err:  # ValueError: the path contains a null character
        raise CameraInfoError(f'{path} cannot be read: {getattr(err, "strerror", err)}; calibrate '
                              'the camera with camera_calibration, or give another path') from err
    return _parse(content, path, warn)


def write_camera(
    path: Path, camera: StoredCamera, name: str, ros_home: Path | None = None,
) -> None:
    """
    Write a calibration atomically, in the exact format of camera_calibration_parsers.

    An existing file is replaced only if it is a calibration.

    :param camera: calibration to write.
    :param ros_home: folder below which missing folders are created; None for none.
    :raises CameraInfoError: the calibration is invalid, the existing file is not a calibration,
        or the file cannot be written.
    """
    try:
        check_camera_name(name)
    except ValueError as err:
        raise CameraInfoError(f'the name of the camera is {name!r:.80}: {err}') from err
    content = yaml.safe_dump(
        _describe(camera, name), sort_keys=False, default_flow_style=None, width=math.inf).encode()
    if len(content) > _FILE_BYTES:
        raise CameraInfoError(f'the calibration has {len(content)} bytes: '
                              f'give a calibration of at most {_FILE_BYTES} bytes')
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
                              f'{remedy}, or give another path') from err


def check_output(path: Path) -> None:
    """
    Check that a calibration can be written to a path, before the work for it.

    :raises CameraInfoError: the path is another file, or has no folder that can be written.
    """
    if os.path.lexists(path):
        _check_replaceable(path)
    elif not os.access(path.parent, os.W_OK | os.X_OK):
        reason = 'it is not writable' if path.parent.is_dir() else 'there is no such folder'
        raise CameraInfoError(f'{path} cannot be written to {path.parent}: {reason}; make the '
                              'folder, or give another path')


def _check_replaceable(path: Path) -> None:
    """Check that an existing file is a calibration; other files must not be replaced."""
    try:
        _parse(read_regular(path, _FILE_BYTES, follow=False), path)
    except (CameraInfoError, RefusedFileError) as err:
        reason = getattr(err, 'strerror', 'the existing file is not a calibration')
        raise CameraInfoError(f'{path} cannot be written: {reason}; '
                              'remove it, or give another path') from err


@dataclass(frozen=True)
class _Document:
    """The content of a file; errors name the file and the key."""

    path: Path
    root: Any

    def get(
        self, key: str, convert: Callable[[Any], _T], expected: str, default: str | None = None,
    ) -> _T:
        value = self.root
        for part in key.split('.'):
            value = value.get(part, default) if isinstance(value, dict) else None
        try:
            return convert(value)
        except (KeyError, TypeError, ValueError) as err:
            found = 'missing' if value is None else reprlib.repr(value)
            raise CameraInfoError(f'{self.path}: {key} is {found}: give {expected}') from err

    def whole(
        self, key: str, lowest: int = 0, highest: int = _UINT32_MAX, default: str | None = None,
    ) -> int:
        def _convert(value: Any) -> int:
            number = int(value, 16) if str(value)[:2].lower() == '0x' else int(value)
            if not lowest <= number <= highest:
                raise ValueError
            return number

        expected = (f'a whole number from {lowest} to {highest}' if lowest < highest
                    else str(lowest))
        return self.get(key, _convert, expected, default)

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
) -> StoredCamera:
    try:
        # BaseLoader returns every scalar as text, like yaml-cpp. yaml.safe_load does not read
        # 1e-05, which yaml-cpp writes, as a number.
        document = _Document(path, _read_ini(content) if _INI.search(content) else yaml.load(
            _OPENCV_YAML.sub(b'', content), yaml.BaseLoader))
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as err:
        mark = getattr(err, 'problem_mark', None)
        line = f' in line {mark.line + 1}' if mark else ''
        raise CameraInfoError(
            f'{path} is not YAML{line}: give the file that camera_calibration writes') from err
    width, height = document.whole('image_width', 1), document.whole('image_height', 1)
    assumed = document.get(
        'camera_model', _CAMERA_MODELS.__getitem__,
        'distortion_model: plumb_bob, rational_polynomial or equidistant', '') if (
            'distortion_model' not in document.root) else ''
    model = document.get('distortion_model', _check_model, 'a text like plumb_bob', assumed)
    binning = [document.whole(key, default='0') for key in ('binning_x', 'binning_y')]
    matrices = {name: tuple(document.matrix(key, rows, cols))
                for key, (name, rows, cols) in _MATRICES.items()}
    if assumed:
        warn(f'{path} has no distortion_model: {assumed} is assumed')
    return StoredCamera(
        width=width, height=height, distortion_model=model, binning_x=binning[0],
        binning_y=binning[1], **matrices,
        roi=_region(document, width, height) if 'roi' in document.root else ImageRegion())


def _read_ini(content: bytes) -> dict[str, Any]:
    """Return the content of an INI file as that of a YAML file."""
    values: dict[str, list[str]] = {}
    numbers: list[str] = []
    for line in map(str.strip, content.decode().splitlines()):
        if line[:1].isalpha():
            numbers = values.setdefault(line.lower(), [])
        elif line[:1] not in ('', '#', ';', '['):
            numbers += line.split()
    root: dict[str, Any] = {f'image_{side}': next(iter(values.get(side, [])), None)
                            for side in ('width', 'height')}
    for name, key in _INI_MATRICES.items():
        _, rows, columns = _MATRICES[key]
        data = values.get(name, [])
        root[key] = {'rows': rows or 1, 'cols': columns or len(data), 'data': data or None}
    is_long = root['distortion_coefficients']['cols'] > 5
    return {**root, 'distortion_model': 'rational_polynomial' if is_long else _DEFAULT_MODEL}


def _region(document: _Document, width: int, height: int) -> ImageRegion:
    left = document.whole('roi.x_offset', 0, width)
    top = document.whole('roi.y_offset', 0, height)
    return ImageRegion(
        x_offset=left, y_offset=top, width=document.whole('roi.width', 0, width - left),
        height=document.whole('roi.height', 0, height - top),
        do_rectify=document.get('roi.do_rectify', _BOOLEANS.__getitem__, 'true or false'))


def _check_model(value: Any) -> str:
    if not isinstance(value, str) or not _MODEL.fullmatch(value):
        raise ValueError
    return value


def _describe(camera: StoredCamera, name: str) -> dict[str, Any]:
    """Return the content of a calibration file, in the order of camera_calibration_parsers."""

    def _matrix(rows: int, cols: int, data: Any) -> dict[str, Any]:
        return {'rows': rows, 'cols': cols, 'data': [float(number) for number in data]}

    return {
        'image_width': camera.width,
        'image_height': camera.height,
        'camera_name': name,
        'camera_matrix': _matrix(3, 3, camera.k),
        'distortion_model': camera.distortion_model,
        'distortion_coefficients': _matrix(1, len(camera.d), camera.d),
        'rectification_matrix': _matrix(3, 3, camera.r),
        'projection_matrix': _matrix(3, 4, camera.p),
        'binning_x': camera.binning_x,
        'binning_y': camera.binning_y,
        'roi': {name: getattr(camera.roi, name)
                for name in ('x_offset', 'y_offset', 'height', 'width', 'do_rectify')},
    }
