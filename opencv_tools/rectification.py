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

"""Images without the distortion of the lens, by the calibration in a camera_info."""

from __future__ import annotations

from collections.abc import Callable
import copy
from dataclasses import dataclass
from threading import Lock
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.encodings import Encoding, find_encoding
from opencv_tools.image.errors import RectificationError
from opencv_tools.image.text import printable
from opencv_tools.image_codecs import convert_image

# Numbers of coefficients that each distortion model may have.
_POLYNOMIAL = (0, 4, 5, 8, 12, 14)
_MODELS = {'plumb_bob': _POLYNOMIAL, 'rational_polynomial': _POLYNOMIAL, 'equidistant': (0, 4)}
_FISHEYE = 'equidistant'
# OpenCV has 16 bits for a coordinate of a pixel.
_MAX_SIDE = 32_766
_MAX_NAME = 64
_IDENTITY = np.eye(3)

#: Lends an array for an image of a height, a width and an encoding, or None.
Lend = Callable[[int, int, Encoding], NDArray[Any] | None]
_Maps = tuple[Any, Any]


@dataclass(frozen=True, kw_only=True)
class _Camera:
    """
    A calibration in pixels of the images, after binning and without the rows outside of the ROI.

    :param matrix: (3, 3) matrix of the raw images.
    :param distortion: coefficients of the distortion; empty if there is none.
    :param rotation: (3, 3) rotation from the raw to the rectified camera.
    :param projection: (3, 3) matrix of the rectified images.
    :param is_fisheye: whether the model of the distortion is equidistant.
    """

    matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]
    rotation: NDArray[np.float64]
    projection: NDArray[np.float64]
    is_fisheye: bool

    @property
    def is_rectified(self) -> bool:
        """Whether rectified images equal the raw ones."""
        return not self.distortion.size and np.allclose(
            self.projection @ self.rotation, self.matrix, rtol=1e-9, atol=1e-9)

    def maps(self, width: int, height: int, *, is_nearest: bool) -> _Maps:
        """Return the maps of ``cv2.remap`` for images of a size."""
        size = width, height
        # Maps of floats are made first, because those of 16 bits wrap coordinates far outside of
        # the image, and OpenCV does not round them to the nearest pixel.
        if self.is_fisheye:
            floats = cv2.fisheye.initUndistortRectifyMap(
                self.matrix, self.distortion, self.rotation, self.projection, size,
                cv2.CV_32FC1)
        else:
            floats = cv2.initUndistortRectifyMap(
                self.matrix, self.distortion if self.distortion.size else None, self.rotation,
                self.projection, size, cv2.CV_32FC1)
        pixels, fractions = cv2.convertMaps(*floats, cv2.CV_16SC2, nninterpolation=is_nearest)
        return pixels, None if is_nearest else fractions


class Rectifier:
    """
    Rectify the images of a camera, with maps that are computed once for each calibration.

    The maps of the last calibration are kept, 6 bytes for each pixel. All methods are thread-safe.
    """

    def __init__(self) -> None:
        """Create a rectifier without maps."""
        self._lock = Lock()
        self._key: tuple[object, ...] = ()
        self._maps: _Maps | None = None

    def rectify(
        self, image: NDArray[Any], encoding: Encoding, camera_info: Any, lend: Lend | None = None,
    ) -> tuple[NDArray[Any], Encoding]:
        """
        Rectify an image.

        The pixels of colour and gray images are interpolated. Bayer and YUV images become
        ``bgr8``, or ``bgr16`` with 16 bits. An image with a generic type, such as a depth image
        with ``16UC1`` or ``32FC1``, gets its nearest pixels, so that no two depths are mixed.
        Pixels outside of the raw image are 0, or NaN in an image of floats with a generic type.

        :param image: (h, w) or (h, w, c) array of any strides and byte order, which is not
            changed; separate chroma rows follow the luma rows.
        :param encoding: encoding of the image.
        :param camera_info: sensor_msgs/CameraInfo of the image.
        :param lend: lends the array of the result; None for a new one.
        :returns: an array of the same height and width, and its encoding. The array is the image
            itself if the calibration has no distortion and the same camera after it.
        :raises RectificationError: the calibration cannot be used, or is not that of the image.
        """
        native = np.ascontiguousarray(image, np.dtype(encoding.dtype))
        if encoding.kind in ('bayer', 'yuv'):
            target = find_encoding('bgr16' if encoding.dtype == 'uint16' else 'bgr8')
            native, encoding = convert_image(native, encoding, target), target
        height, width = native.shape[:2]
        maps = self._find_maps(camera_info, width, height, encoding.is_generic)
        if maps is None:
            return native, encoding
        is_float = native.dtype.kind == 'f'
        try:
            return cv2.remap(
                native, *maps, cv2.INTER_NEAREST if encoding.is_generic else cv2.INTER_LINEAR,
                dst=lend(height, width, encoding) if lend else None,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=(float('nan'),) * 4 if is_float else 0), encoding
        except cv2.error as err:
            raise RectificationError(f'OpenCV cannot rectify a {width}x{height} {encoding.name} '
                                     f'image: {err.err}') from err

    def _find_maps(
        self, info: Any, width: int, height: int, is_nearest: bool,
    ) -> _Maps | None:
        """Return the maps of a calibration; None if rectified images equal the raw ones."""
        key = (width, height, is_nearest, *_content(info))
        with self._lock:
            if key != self._key:
                camera = _read_camera(info, width, height)
                self._maps = None if camera.is_rectified else camera.maps(
                    width, height, is_nearest=is_nearest)
                self._key = key
            return self._maps


def rectified_info(camera_info: Any, width: int, height: int) -> Any:
    """
    Return the camera_info of the rectified images of a camera.

    :param camera_info: sensor_msgs/CameraInfo of the raw images.
    :param width: width of the images in pixels.
    :param height: height of the images in pixels.
    :returns: a copy without distortion and rotation, whose K is the first part of P.
    :raises RectificationError: the calibration cannot be used, or is not that of the images.
    """
    _read_camera(camera_info, width, height)
    info = copy.deepcopy(camera_info)
    info.distortion_model, info.d = 'plumb_bob', [0.0] * 5
    info.k = np.reshape(info.p, (3, 4))[:, :3].ravel()
    info.r = _IDENTITY.ravel()
    info.roi.do_rectify = False
    return info


def _content(info: Any) -> tuple[object, ...]:
    """Return what the maps depend on, as values that can be compared."""
    roi = info.roi
    return (info.width, info.height, info.distortion_model, info.binning_x, info.binning_y,
            roi.x_offset, roi.y_offset, roi.width, roi.height,
            *(np.asarray(field, np.float64).tobytes()
              for field in (info.k, info.d, info.r, info.p)))


def _read_camera(info: Any, width: int, height: int) -> _Camera:
    """
    Check a calibration, and convert it to the pixels of its images.

    Binning and ROI change the pixels as in ``PinholeCameraModel`` of image_geometry.

    :raises RectificationError: the calibration cannot be used, or is not that of such images.
    """
    offset, scale = _check_size(info, width, height)
    matrix, rotation = (np.array(field, np.float64).reshape(3, 3) for field in (info.k, info.r))
    projection = np.array(info.p, np.float64).reshape(3, 4)[:, :3]
    if not matrix.any():
        raise RectificationError('the camera_info has no calibration, because its K is zero: '
                                 'calibrate the camera, for example with img_calibrate')
    distortion = _read_distortion(info)
    for name, values in (('K', matrix), ('R', rotation), ('P', projection), ('D', distortion)):
        if not np.isfinite(values).all():
            raise RectificationError(f'{name} of the camera_info has the value '
                                     f'{values[~np.isfinite(values)][0]}: give finite numbers')
    for name, values in (('K', matrix), ('P', projection)):
        if min(values[0, 0], values[1, 1]) <= 0:
            raise RectificationError(
                f'{name} of the camera_info has the focal lengths {values[0, 0]:g} and '
                f'{values[1, 1]:g}: give numbers above 0')
        values[:2, 2] -= offset
        values[:2] *= scale[:, np.newaxis]
    if not _is_invertible(projection, rotation):
        raise RectificationError('P and R of the camera_info cannot be inverted: give a rotation '
                                 'as R, for example the identity, and 0 0 1 0 as last row of P')
    return _Camera(matrix=matrix, distortion=distortion, rotation=rotation,
                   projection=projection, is_fisheye=info.distortion_model == _FISHEYE)


def _check_size(
    info: Any, width: int, height: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the offset of an image in pixels of the sensor, and the scale that follows."""
    roi = info.roi
    binning = max(1, info.binning_x), max(1, info.binning_y)
    is_whole = not (roi.x_offset or roi.y_offset or roi.width or roi.height)
    sides = (info.width, info.height) if is_whole else (roi.width, roi.height)
    expected = [side // step for side, step in zip(sides, binning, strict=True)]
    rounded_up = [-(-side // step) for side, step in zip(sides, binning, strict=True)]
    described = f'{expected[0]}x{expected[1]} pixels'
    if not is_whole:
        described += f', its ROI in {info.width}x{info.height}'
    if max(binning) > 1:
        described += f', with a binning of {binning[0]}x{binning[1]}'
    if width not in (expected[0], rounded_up[0]) or height not in (expected[1], rounded_up[1]):
        raise RectificationError(f'the image has {width}x{height} pixels, but its camera_info is '
                                 f'for {described}: publish the calibration of this size')
    if not 1 <= min(width, height) <= max(width, height) <= _MAX_SIDE:
        raise RectificationError(f'the image has {width}x{height} pixels: an image with 1 to '
                                 f'{_MAX_SIDE} pixels a side can be rectified')
    return np.array([roi.x_offset, roi.y_offset], np.float64), 1 / np.array(binning, np.float64)


def _read_distortion(info: Any) -> NDArray[np.float64]:
    """Return the coefficients of the distortion, none if there is no distortion."""
    coefficients = np.array(info.d, np.float64)
    model = info.distortion_model
    is_zero = not coefficients.any()
    if model not in _MODELS:
        if is_zero:
            return coefficients[:0]
        raise RectificationError(
            f"the distortion model '{printable(model, _MAX_NAME)}' of the camera_info is unknown: "
            f'give {", ".join(_MODELS)}')
    if len(coefficients) not in _MODELS[model]:
        raise RectificationError(
            f'D of the camera_info has {len(coefficients)} coefficients: give '
            f'{", ".join(map(str, _MODELS[model]))} for {model}')
    if model == _FISHEYE:  # which is no pinhole camera, even if all are zero
        return coefficients if coefficients.size else np.zeros(4)
    return coefficients[:0] if is_zero else coefficients


def _is_invertible(projection: NDArray[np.float64], rotation: NDArray[np.float64]) -> bool:
    with np.errstate(all='ignore'):
        try:
            product = projection @ rotation
            return bool(np.isfinite([product, np.linalg.inv(product)]).all())
        except np.linalg.LinAlgError:
            return False
