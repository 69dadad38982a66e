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

"""Conversion of numbers to the types of message fields, without a change of their values."""

from __future__ import annotations

from typing import Any

import numpy as np


def convert_numbers(value: Any, dtype: np.dtype[Any]) -> np.ndarray[Any, Any] | None:
    """
    Return numbers as an array of a type; None if it cannot represent them.

    Floats are rounded to a type of floats. Integers are never changed.

    :param value: sequence, array or other buffer of one dimension.
    :param dtype: type of the result.
    :raises TypeError: the value is no sequence.
    :raises ValueError: a value is no number.
    :raises OverflowError: a number is too large.
    """
    given = np.asarray(value)
    if given.ndim != 1 or (given.size and given.dtype.kind not in 'biuf'):
        raise ValueError('not a number')
    if dtype.kind == 'f':
        with np.errstate(invalid='ignore', over='ignore'):
            converted = given.astype(dtype)
        return converted if np.array_equal(np.isfinite(converted), np.isfinite(given)) else None
    if given.dtype.kind != 'f':
        converted = given.astype(dtype)
        return converted if np.array_equal(converted, given) else None
    if not np.isfinite(given).all():
        return None
    # numpy rounds integers beside floats, and beside integers of another sign.
    exact = given.tolist() if isinstance(value, np.ndarray | memoryview) else [*value]
    numbers = [int(number) for number in exact]
    least, most = (0, 1) if dtype.kind == 'b' else (np.iinfo(dtype).min, np.iinfo(dtype).max)
    fits = numbers == exact and all(least <= number <= most for number in numbers)
    return np.array(numbers, dtype) if fits else None
