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

"""Numbers as the texts of XML have them."""

from __future__ import annotations

import math
import sys

from opencv_tools.robot.xml.document import AnyElement, DescriptionError

# A limit of this magnitude or more means no limit, because URDF and older SDF have no infinity.
UNLIMITED = 1e16


def numbers(text: str | None, count: int, element: AnyElement, what: str = ''
            ) -> tuple[float, ...]:
    """
    Read numbers that stand in a text.

    :param count: how many there have to be.
    :param what: the attribute that has them, for messages; empty for the text of the element.
    :raises DescriptionError: there are others, or one is not a number, or not finite.
    """
    try:
        values = tuple(map(_float, (text or '').split()))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        wanted = 'a finite number' if count == 1 else f'{count} finite numbers'
        subject = f'{what}=' if what else ''
        raise DescriptionError(f'{subject}{quoted(text)} is not {wanted}', element)
    return values


def number(text: str | None, element: AnyElement, what: str = '') -> float:
    """Read one number, as `numbers` does."""
    return numbers(text, 1, element, what)[0]


def vector(text: str | None, element: AnyElement, what: str = '') -> tuple[float, float, float]:
    """Read three numbers, as `numbers` does."""
    x, y, z = numbers(text, 3, element, what)
    return x, y, z


def limit_number(text: str | None, element: AnyElement, what: str = '') -> float:
    """Read a limit; one as large as `UNLIMITED` means none, which is infinite."""
    try:
        value = _float((text or '').strip())
    except ValueError:
        value = math.nan
    if math.isnan(value):
        subject = f'{what}=' if what else ''
        raise DescriptionError(f'{subject}{quoted(text)} is not a number', element)
    return math.copysign(math.inf, value) if abs(value) >= UNLIMITED else value


def quoted(text: str | None) -> str:
    """Quote a text in a message, the beginning of one that is long."""
    text = (text or '').strip()
    return repr(text if len(text) <= 60 else f'{text[:57]}...')


def _float(word: str) -> float:
    """Read a number as C does: Python's digits of other scripts and underscores are none."""
    if '_' in word or not word.isascii():
        raise ValueError
    return float(word)


def unclamped(text: str, kept: str | None) -> str:
    """
    Return the colour that a writer cut to 0 and 1, unless someone changed it since.

    :param text: the colour as it stands there.
    :param kept: the colour of before; None where it was not cut.
    """
    try:
        values, before = (tuple(map(_float, words.split())) for words in (text, kept or ''))
    except ValueError:
        return text
    return kept if kept and values == clamped(before) else text


def clamped(values: tuple[float, ...]) -> tuple[float, ...]:
    """Cut the parts of a colour to 0 and 1."""
    return tuple(min(max(value, 0.0), 1.0) for value in values)


def number_text(value: float) -> str:
    """
    Write a number so that reading it gives the same one, a whole one without a point.

    Numbers so small that C++ cannot read them are 0.
    """
    if abs(value) < sys.float_info.min:
        value = 0.0
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


def numbers_text(values: tuple[float, ...]) -> str:
    """Write numbers with spaces between them."""
    return ' '.join(map(number_text, values))
