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

"""The calibration that is published as ``camera_info``, scaled, flipped and rotated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from numpy.typing import NDArray
from opencv_tools.base.logs import Log
from opencv_tools.image.errors import RectificationError
from opencv_tools.image.orientation import turned_axes
from opencv_tools.nodes.publisher.calibration_file import (
    CameraInfoError, read_camera_info, write_camera_info)
from opencv_tools.nodes.publisher.parameters import PublisherSettings
from opencv_tools.rectification import rectified_info
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, RegionOfInterest
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Header

# Models with the coefficients k1, k2, p1, p2, k3 ... k6, s1 ... s4, tau_x, tau_y of OpenCV.
_POLYNOMIALS = ('plumb_bob', 'rational_polynomial')
_POLYNOMIAL_LENGTHS = (4, 5, 8, 12, 14)
_TILT = 12
# Indices of pairs of coefficients that turn like x and y: (p2, p1), (s1, s3) and (s2, s4).
_VECTORS = ((3, 2), (8, 10), (9, 11))
# Models with rotational symmetry.
_SYMMETRIC = ('equidistant',)


def turn_camera_info(info: CameraInfo, axes: NDArray[np.float64]) -> CameraInfo:
    """
    Convert a calibration to flipped or rotated images.

    The optical frame turns with the image: x still points right, and y down.

    :param info: calibration to convert.
    :param axes: (2, 2) matrix of ``turned_axes``; its transpose is the inverse.
    :returns: a copy for the turned images.
    :raises CameraInfoError: CameraInfo cannot represent the turned camera.
    """
    turned = copy.deepcopy(info)
    if (axes == np.eye(2)).all():
        return turned
    order = np.abs(axes).argmax(1)
    is_reversed = axes.sum(1) < 0
    size = np.array([info.width, info.height])[order]
    space = np.eye(3)
    space[:2, :2] = axes
    pixels = space.copy()
    pixels[:2, 2] = np.where(is_reversed, size - 1, 0)
    k = pixels @ info.k.reshape(3, 3) @ space.T
    p = pixels @ info.p.reshape(3, 4)
    p[:, :3] = p[:, :3] @ space.T
    if k[1, 0] or p[1, 0]:
        raise CameraInfoError('a calibration with skewed pixel axes cannot be rotated: '
                              'set rotate to 0')
    r = space @ info.r.reshape(3, 3) @ space.T
    # Adding 0.0 converts -0.0 to 0.0.
    turned.k, turned.p, turned.r = ((matrix + 0.0).ravel() for matrix in (k, p, r))
    turned.d = _turn_distortion(info.distortion_model, info.d, axes)
    turned.width, turned.height = map(int, size)
    binning = [info.binning_x, info.binning_y]
    turned.binning_x, turned.binning_y = (binning[side] for side in order)
    if info.roi.width or info.roi.height:
        turned.roi = _turn_region(info, order, is_reversed)
    return turned


def _turn_distortion(
    model: str, coefficients: Sequence[float], axes: NDArray[np.float64],
) -> list[float]:
    """Turn the coefficients of a distortion model, if the model is supported."""
    turned = np.array(coefficients, np.float64)
    if not turned.any() or model in _SYMMETRIC:
        return turned.tolist()
    is_supported = model in _POLYNOMIALS and len(turned) in _POLYNOMIAL_LENGTHS
    if not is_supported or turned[_TILT:].any():
        raise CameraInfoError(
            f'a calibration with {len(turned)} coefficients of distortion model {model!r} can be '
            'neither flipped nor rotated: set flip to none and rotate to 0')
    for pair in _VECTORS:
        if max(pair) < len(turned):
            turned[[*pair]] = axes @ turned[[*pair]] + 0.0
    return turned.tolist()


def _turn_region(
    info: CameraInfo, order: NDArray[np.int_], is_reversed: NDArray[np.bool_],
) -> RegionOfInterest:
    roi = info.roi
    sizes = info.width, info.height
    starts, lengths = (roi.x_offset, roi.y_offset), (roi.width, roi.height)
    (x, width), (y, height) = (
        (max(0, sizes[side] - starts[side] - lengths[side]) if backwards else starts[side],
         lengths[side])
        for side, backwards in zip(order, is_reversed, strict=True))
    return RegionOfInterest(
        x_offset=x, y_offset=y, width=width, height=height, do_rectify=roi.do_rectify)


DEFAULT_URL = 'file://${ROS_HOME}/camera_info/${NAME}.yaml'

_ASPECT_TOLERANCE = 0.01


def ros_home() -> Path:
    """
    Return the folder of ROS for user data.

    :raises RuntimeError: there is no home directory.
    """
    return Path(os.environ.get('ROS_HOME') or Path('~/.ros').expanduser())


def resolve_url(url: str, name: str) -> Path:
    """
    Return the file of a calibration URL, as camera_info_manager resolves it.

    :param url: ``file:///path``, ``package://package/path`` or a path; ``${NAME}`` and
        ``${ROS_HOME}`` are replaced.
    :returns: path of the file, which may not exist.
    :raises CameraInfoError: the URL does not name a file.
    """

    def _value(variable: re.Match[str]) -> str:
        if variable[0] == '${NAME}':
            return name
        if variable[0] == '${ROS_HOME}':
            return str(ros_home())
        raise CameraInfoError(f'calibration URL {url!r} has the unknown variable {variable[0]}: '
                              'use ${NAME} or ${ROS_HOME}')

    try:
        resolved = re.sub(r'\$\{[^}]*\}?', _value, url)
        scheme, separator, location = resolved.partition('://')
        if not separator:
            return Path(resolved).expanduser()
    except RuntimeError as err:
        raise CameraInfoError(
            f'calibration URL {url!r} needs a home directory: give an absolute path') from err
    if scheme.lower() == 'file' and location.startswith('/'):
        return Path(location)
    package, *parts = location.split('/')
    if scheme.lower() != 'package' or not package or not parts:
        raise CameraInfoError(f'calibration URL {url!r} resolves to {resolved!r}: '
                              'give file:///PATH, package://PACKAGE/PATH or a path')
    if {'', '.', '..'} & set(parts):
        raise CameraInfoError(f'calibration URL {url!r} resolves to {resolved!r}, which may be '
                              "outside the package: give package://PACKAGE/PATH without '..' "
                              "and '//'")
    try:
        return Path(get_package_share_directory(package), *parts)
    except (LookupError, OSError, ValueError) as err:  # OSError: AMENT_PREFIX_PATH is unset
        raise CameraInfoError(f'calibration URL {url!r} names the unknown package {package}: '
                              'source the workspace of this package') from err


def scale_camera_info(info: CameraInfo, width: int, height: int) -> CameraInfo:
    """
    Convert a calibration to another size of the same image.

    The rows of K and P are multiplied by the ratios of the sizes, without a shift by half a pixel.
    ``PinholeCameraModel::fromCameraInfo`` of image_geometry does the same for binning. D and R do
    not depend on the size. A region of interest grows to whole pixels.

    :param info: calibration to scale.
    :param width: width of the images in pixels.
    :param height: height of the images in pixels.
    :returns: a copy for that size.
    :raises CameraInfoError: the aspect ratios differ by more than 1 %, so that the image may have
        been cropped or stretched.
    """
    same_aspect = math.isclose(
        width * info.height, height * info.width, rel_tol=_ASPECT_TOLERANCE)
    if min(width, height, info.width, info.height) < 1 or not same_aspect:
        raise CameraInfoError(
            f'a calibration for {info.width}x{info.height} cannot be scaled to images of '
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


def check_lens(info: CameraInfo) -> None:
    """
    Check that images can be rectified with a calibration.

    :param info: calibration; its sizes are not checked.
    :raises CameraInfoError: K or P has no positive focal lengths, K, D, R or P has numbers that
        are not finite, or D does not suit the distortion model.
    """
    coefficients = info.d
    if not np.any(coefficients) and (info.distortion_model or len(coefficients)):
        # A rectification takes zeros of any model and number.
        coefficients = np.ones(len(coefficients) or 4)
    try:
        rectified_info(CameraInfo(
            width=1, height=1, distortion_model=info.distortion_model, d=coefficients, k=info.k,
            r=info.r, p=info.p), 1, 1)
    except RectificationError as err:
        raise CameraInfoError(str(err)) from err


class PublishedCalibration:
    """
    The calibration of a camera, published as ``camera_info``.

    The file has the calibration of the images before ``flip`` and ``rotate``. If it cannot be
    loaded, a warning is logged and the camera counts as uncalibrated. ``save`` and ``message``
    may run on different threads.

    :param url: URL of the file, see ``resolve_url``; '' for ``DEFAULT_URL``, where the file may
        be missing.
    :param warn: called with a sentence for each problem.
    """

    def __init__(self, url: str, name: str, warn: Callable[[str], object]) -> None:
        self._name = name
        self._warn = warn
        self._saving = Lock()
        self._ros_home: Path | None = None
        self._path: Path | None = None
        self._refusal = ''
        with suppress(RuntimeError):  # there is no home directory
            self._ros_home = ros_home()
        info = None
        try:
            # The path is resolved once, so that later changes of the environment have no effect.
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
        Return the message for an image.

        :param width: width of the image in pixels.
        :param height: height of the image in pixels.
        :param flip: mirroring of the image, see ``orient``.
        :param rotate: clockwise rotation of the image in degrees, see ``orient``.
        :returns: a new message; without a calibration for this image all zero except for header
            and size, as sensor_msgs/CameraInfo defines it.
        """
        message = copy.deepcopy(self._fitted(width, height, flip, rotate))
        message.header = header
        return message

    def save(self, info: CameraInfo, flip: str = 'none', rotate: int = 0) -> str:
        """
        Write a new calibration to the file and publish it from now on.

        The file gets the calibration of the images before ``flip`` and ``rotate``.

        :param info: calibration of the published images, from service ``set_camera_info``.
        :param flip: mirroring of the published images, see ``orient``.
        :param rotate: clockwise rotation of the published images in degrees, see ``orient``.
        :returns: path of the file.
        :raises CameraInfoError: the calibration is invalid, or the file cannot be written; the
            previous calibration stays in use.
        """
        check_lens(info)
        with self._saving:  # the file and the published calibration stay the same
            if self._path is None:
                raise CameraInfoError(self._refusal)
            unturned = turn_camera_info(info, turned_axes(flip, rotate).T)
            write_camera_info(self._path, unturned, self._name, self._ros_home)
            self._use(read_camera_info(self._path))
        return str(self._path)

    def _use(self, info: CameraInfo | None) -> None:
        # One assignment replaces the calibration and its cache, as message() runs concurrently.
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


def open_calibration(node: Node, settings: PublisherSettings) -> PublishedCalibration:
    """Return the calibration that the parameters of a node select; problems are logged."""
    name = settings.camera_name or node.get_namespace().strip('/').replace('/', '_') or 'camera'
    return PublishedCalibration(settings.camera_info_url, name, Log(node.get_logger()).warning)


def create_camera_info_service(
    node: Node, calibration: PublishedCalibration, settings: Callable[[], PublisherSettings],
) -> None:
    """
    Create the service ``set_camera_info``, which saves and publishes a new calibration.

    :param calibration: calibration to replace.
    """
    log = Log(node.get_logger())

    def _set(
        request: SetCameraInfo.Request, response: SetCameraInfo.Response,
    ) -> SetCameraInfo.Response:
        try:
            response.status_message = calibration.save(
                request.camera_info, settings().capture.flip, settings().capture.rotate)
            response.success = True
        except CameraInfoError as err:
            response.status_message = str(err)
        log.info(f'set_camera_info: {response.status_message}')
        return response

    node.create_service(SetCameraInfo, 'set_camera_info', _set)


def _scale_span(start: int, length: int, size: int, old_size: int) -> tuple[int, int]:
    """Scale an interval and extend it to whole pixels, so that it is never empty."""
    first = start * size // old_size
    last = -(-(start + length) * size // old_size)
    return first, last - first
