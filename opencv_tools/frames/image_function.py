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

"""A function of an image, whose result is published."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import inspect
from typing import Any

import numpy as np
from numpy.typing import NDArray
from opencv_tools.cv_bridge import CvBridgeError
from opencv_tools.frames.frame import Frame
from opencv_tools.frames.loan import LoanedFrame
from opencv_tools.frames.publisher import FramePublisher
from opencv_tools.image.encodings import find_encoding


class ImageFunction:
    """
    Call a function with images and publish its results.

    A function with a parameter ``out`` that has no default fills an array with the shape and
    encoding of its image, as ``cv2.flip(image, 1, dst=out)`` does. That array is published unless
    the function returns another one.
    """

    def __init__(
        self, function: Callable[..., Any], arguments: Sequence[Any] = (),
        keywords: Mapping[str, Any] | None = None,
    ) -> None:
        """
        Look for the parameter ``out``.

        :param function: returns an image, several values of which the last one is an image, or
            None for no image.
        :param arguments: arguments after the image.
        :param keywords: arguments by name.
        """
        self._function = function
        self._arguments = arguments
        self._keywords = {**(keywords or {})}
        self._fills_out = 'out' not in self._keywords and _requires_out(function)

    def publish(self, frame: Frame, publisher: FramePublisher) -> None:
        """
        Apply the function to a frame and publish the result with the header of the frame.

        :raises CvBridgeError: the function returns something else than an image.
        """
        if not self._fills_out:
            image = self._call(frame)
            if image is not None:
                publisher.publish(image, frame)
            return
        rows, width = frame.image.shape[:2]
        height = find_encoding(frame.encoding).height(rows)
        with publisher.loan(height, width, frame.encoding, frame) as loan:
            image = self._fill(frame, loan)
            if image is not None:
                publisher.publish(image, frame)
                loan.give_back()

    def _fill(self, frame: Frame, loan: LoanedFrame) -> NDArray[Any] | None:
        """Fill a loan; return an image that is published instead, or None."""
        image = self._call(frame, out=loan.image)
        return None if image is loan.image else image

    def _call(self, frame: Frame, **out: NDArray[Any]) -> NDArray[Any] | None:
        result = self._function(frame.image, *self._arguments, **self._keywords, **out)
        image = result[-1] if isinstance(result, tuple) and result else result
        if image is None or isinstance(image, np.ndarray):
            return image
        raise CvBridgeError(f'the function returned {type(image).__name__}, not an array')


def _requires_out(function: Callable[..., Any]) -> bool:
    """Return whether a function has a parameter ``out`` without a default."""
    try:
        out = inspect.signature(function).parameters.get('out')
    except (TypeError, ValueError):  # functions in C have no signature
        return False
    return out is not None and out.default is out.empty and out.kind in (
        out.POSITIONAL_OR_KEYWORD, out.KEYWORD_ONLY)
