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
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.camera_model import Maps, read_camera_model
from opencv_tools.image.encodings import Encoding, find_encoding
from opencv_tools.image.errors import RectificationError
from opencv_tools.image_codecs import convert_image
from opencv_tools.opencv import cv2

#: Lends an array for an image of a height, a width and an encoding, or None.
Lend = Callable[[int, int, Encoding], NDArray[Any] | None]


class Rectifier:
    """
    Rectify the images of a camera, with maps that are computed once for each calibration.

    The maps of the last calibration are kept, 6 bytes for each pixel. All methods are thread-safe.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._key: tuple[object, ...] = ()
        self._maps: Maps | None = None
        self._rays_key: tuple[object, ...] = ()
        self._rays = np.empty((0, 0, 2), np.float32)

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

    def rays(self, camera_info: Any, width: int, height: int) -> NDArray[np.float32]:
        """
        Return the directions of the pixels of raw images, computed once for each calibration.

        :returns: (h, w, 2) array, see `CameraModel.rays`.
        :raises RectificationError: the calibration cannot be used, or is not that of such images.
        """
        key = (width, height, *_content(camera_info))
        with self._lock:
            if key != self._rays_key:
                camera = read_camera_model(camera_info, width, height)
                self._rays = camera.rays(width, height).astype(np.float32)
                self._rays_key = key
            return self._rays

    def _find_maps(
        self, info: Any, width: int, height: int, is_nearest: bool,
    ) -> Maps | None:
        """Return the maps of a calibration; None if rectified images equal the raw ones."""
        key = (width, height, is_nearest, *_content(info))
        with self._lock:
            if key != self._key:
                camera = read_camera_model(info, width, height)
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
    read_camera_model(camera_info, width, height)
    info = copy.deepcopy(camera_info)
    info.distortion_model, info.d = 'plumb_bob', [0.0] * 5
    projection = np.reshape(info.p, (3, 4))
    if not projection.any():  # not set, see read_camera_model
        projection = np.column_stack((np.reshape(info.k, (3, 3)), np.zeros(3)))
    info.k, info.p = projection[:, :3].ravel(), projection.ravel()
    info.r = np.eye(3).ravel()
    info.roi.do_rectify = False
    return info


def _content(info: Any) -> tuple[object, ...]:
    """Return what the maps depend on, as values that can be compared."""
    roi = info.roi
    return (info.width, info.height, info.distortion_model, info.binning_x, info.binning_y,
            roi.x_offset, roi.y_offset, roi.width, roi.height,
            *(np.asarray(field, np.float64).tobytes()
              for field in (info.k, info.d, info.r, info.p)))
