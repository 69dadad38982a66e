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

"""An image that is filled in the memory where subscribers read it."""

from __future__ import annotations

from collections.abc import Callable
from operator import index
import os
from types import TracebackType
from typing import Any
import weakref

import numpy as np
from numpy.typing import NDArray
from opencv_tools.base.logs import Log
from opencv_tools.frames.frame import Frame
from opencv_tools.image.encodings import Encoding
from opencv_tools.image.errors import LayoutError
from opencv_tools.image.layout import view_image
from opencv_tools.transport.shared_frames.writer import Slot
from std_msgs.msg import Header

_MAX_BYTES = 2**32 - 1  # of the data of a message

# Bytes in an image that nobody has written to. A smaller image could have them by chance.
_MARK = np.frombuffer(os.urandom(16), np.uint8)
_LEAST_BYTES = 64


class LoanedFrame:
    """
    An image to fill in a ``with`` block, whose end publishes it.

    Subscribers on this machine read it where it was filled. If there are none, it has ordinary
    memory and is published as any other image. A block that raises an exception publishes nothing.
    """

    def __init__(
        self, height: int, width: int, encoding: Encoding, *,
        source: Frame | Header | None, lend: Callable[[int], Slot | None],
        publish: Callable[[NDArray[Any], Frame | Header | None, Slot | None], object], log: Log,
    ) -> None:
        """
        Check the size. The memory is lent at the begin of the block.

        :param lend: lends shared memory for a number of bytes, if it has readers.
        :param publish: publishes the image with a source; a slot has its pixels.
        :raises LayoutError: the encoding has no image of this size, or no message has so much.
        """
        self._height, self._width = (
            _pixels(name, value) for name, value in (('height', height), ('width', width)))
        self._encoding = encoding
        self._size = encoding.size(self._height, self._width)
        if self._size > _MAX_BYTES:
            raise LayoutError(f'{width}x{height} {encoding.name} is {self._size} bytes: a message '
                              f'has at most {_MAX_BYTES}')
        if not encoding.is_valid_size(height, width):
            raise LayoutError(f'{encoding.name} has no image of {width}x{height}: give an even '
                              'width and height')
        #: Frame or header whose stamp and coordinate frame the message gets, see `publish`.
        self.source = source
        self._lend = lend
        self._publish = publish
        self._log = log
        self._is_new = True
        self._image: NDArray[Any] | None = None
        self._slot: Slot | None = None
        self._views: weakref.ref[Any] | None = None
        #: Bytes of the image that are not changed, if nobody writes to it.
        self._marks: NDArray[np.uint8] | None = None

    @property
    def image(self) -> NDArray[Any]:
        """
        Return the image, (h, w) or (h, w, c), not initialised; chroma rows follow the luma rows.

        An assigned array is copied into it. A view of the image that exists after the block is
        the user's: then a copy of the image is published.

        :raises RuntimeError: before the block, after it, and after ``give_back``.
        """
        if self._image is None:
            raise RuntimeError('a loaned frame has an image inside its with block only, until '
                               'give_back()')
        return self._image

    @image.setter
    def image(self, image: NDArray[Any]) -> None:
        if image is not self.image:
            np.copyto(self.image, image)

    def give_back(self) -> None:
        """
        Publish nothing at the end of the block.

        :raises RuntimeError: before the block, after it, and if it was given back already.
        """
        if self.image is not None:
            self._image = self._slot = self._marks = None

    def __enter__(self) -> LoanedFrame:
        """
        Lend the memory.

        :raises RuntimeError: this loan had a block before.
        """
        if not self._is_new:
            raise RuntimeError('a loan is for one with block: call loan() for each frame')
        self._is_new = False
        self._slot = self._lend(self._size)
        if self._slot:
            data, self._views = self._slot.loan()
            self._published = self._view(self._slot.data)
        else:
            data = np.empty(self._size, np.uint8)
        self._image = self._view(data)
        self._marks = self._marked(self._image)
        self._marks[:] = _MARK[:len(self._marks)]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, _: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Publish the image, unless an exception was raised or it was given back."""
        image, slot, marks = self._image, self._slot, self._marks
        self._image = self._slot = self._marks = None
        if image is None or marks is None or kind is not None:
            return
        left, marks = marks.tobytes(), None  # which was a view
        if left and left == _MARK.tobytes():
            self._log.error(
                'a loaned frame is not published, because nothing was written to its image: '
                "OpenCV writes to 'dst' only if it has the size and type of the result",
                every=1.0, key='loan')
            return
        if slot and self._views:
            image = self._published  # ``image`` was the last view, if the user has no other
            memory = self._views()
            if memory is not None:
                image, slot = self._view(np.asarray(memory)), None
                self._log.warning(
                    'a loaned frame is copied, because an array of it is in use after its block: '
                    'write loan.image instead of a name of your own', once='loan')
        self._publish(image, self.source, slot)

    def _marked(self, image: NDArray[Any]) -> NDArray[np.uint8]:
        """Return a view of bytes from the first to the last one; none of a small image."""
        step = (self._size - 1) // (len(_MARK) - 1)
        end = (len(_MARK) - 1) * step + 1 if self._size >= _LEAST_BYTES else 0
        return image.reshape(-1).view(np.uint8)[:end:max(1, step)]

    def _view(self, data: NDArray[np.uint8]) -> NDArray[Any]:
        return view_image(data, self._height, self._width, self._encoding)


def _pixels(name: str, value: Any) -> int:
    """Return a side of an image as an integer of Python."""
    try:
        number = 0 if isinstance(value, bool | np.bool_) else index(value)
    except TypeError:
        number = 0
    if number < 1:
        raise LayoutError(f'{name} is {value!r}: give a whole number of pixels, at least 1')
    return number
