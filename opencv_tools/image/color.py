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

"""Conversion of images between encodings, with the arithmetic of OpenCV."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.image.bayer import bayer_to_color
from opencv_tools.image.channels import reorder
from opencv_tools.image.depth import change_depth
from opencv_tools.image.encodings import Encoding, encodings_between
from opencv_tools.image.errors import ConversionError
from opencv_tools.image.yuv import yuv_to_color


def convert(
    image: NDArray[Any], source: Encoding, target: Encoding,
) -> NDArray[Any]:
    """
    Convert an image from one encoding to another: colours first, then depth.

    :param image: (h, w) or (h, w, c) array of any byte order and strides, which is not changed;
        (rows, w) for encodings with chroma in separate rows, which follow the luma rows.
    :param source: encoding of the image.
    :param target: encoding of the result.
    :returns: a new contiguous array in native byte order: (h, w) for one channel, (h, w, c)
        otherwise.
    :raises ConversionError: the conversion is not supported; the texts are those of cv_bridge.
    """
    if source.name == target.name:
        return np.array(image, source.dtype, order='C')
    _check_conversion(source, target)
    native = np.ascontiguousarray(image, np.dtype(source.dtype))
    if not native.size:
        rows = source.height(len(native)) if target.kind == 'color' else len(native)
        channels = () if target.channels == 1 else (target.channels,)
        return np.empty((rows, native.shape[1], *channels), target.dtype)
    converted = native
    if target.kind == 'color' and source.order != target.order:
        if source.kind == 'bayer':
            converted = bayer_to_color(native, source.order, target.order)
        elif source.kind == 'yuv':
            converted = yuv_to_color(native, source, target.order)
        else:
            converted = reorder(native, source.order, target.order)
    converted = change_depth(converted, target.dtype)
    return converted.copy() if np.may_share_memory(converted, image) else converted


def convert_to(image: NDArray[Any], source: Encoding, desired: str) -> NDArray[Any]:
    """
    Convert an image to an encoding given by name, as cv_bridge does.

    :param image: as for ``convert``.
    :param source: encoding of the image.
    :param desired: as for ``encodings_between``.
    :returns: as from ``convert``.
    :raises EncodingError: as from ``encodings_between``.
    :raises ConversionError: the conversion is not supported; the texts are those of cv_bridge.
    """
    return convert(image, *encodings_between(source, desired))


def _check_conversion(source: Encoding, target: Encoding) -> None:
    """Check that a conversion is supported; the texts of the errors are those of cv_bridge."""
    if not source.is_generic and target.kind == 'color':
        return
    if not source.is_generic and not target.is_generic:
        raise ConversionError(
            f'Unsupported conversion from [{source.name}] to [{target.name}]')
    if not target.is_generic:
        raise ConversionError(f'[{source.name}] is not a color format. but [{target.name}] is. '
                              'The conversion does not make sense')
    if not source.is_generic and (
            source.channels != target.channels or source.row_factor != 1):
        raise ConversionError(
            f'[{source.name}] is a color format but [{target.name}] is not so they must have '
            'the same OpenCV type, CV_8UC3, CV16UC1 ....')
    if source.channels != target.channels:
        raise ConversionError(
            f'[{source.name}] and [{target.name}] do not have the same number of channel')
    if not target.dtype:
        raise ConversionError(f'Unrecognized image encoding [{target.name}]')
