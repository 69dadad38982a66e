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

"""Numbers in the texts of XML."""

from __future__ import annotations

import math
import sys

from opencv_tools.robot.xml.document import AnyElement, DescriptionError, required_attribute

# A limit of this magnitude or more means no limit, because URDF and older SDF have no infinity.
UNLIMITED = 1e16


def numbers(text: str | None, count: int, element: AnyElement, attribute: str = ''
            ) -> tuple[float, ...]:
    """
    Read finite numbers from a text.

    :param attribute: attribute with the text, for messages; empty for the text of the element.
    :raises DescriptionError: the text is not ``count`` finite numbers.
    """
    try:
        values = tuple(map(c_float, (text or '').split()))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        expected = 'a finite number' if count == 1 else f'{count} finite numbers'
        raise _error(text, expected, element, attribute)
    return values


def number(text: str | None, element: AnyElement, attribute: str = '') -> float:
    """Read one number, as `numbers` does."""
    return numbers(text, 1, element, attribute)[0]


def required_number(element: AnyElement, name: str) -> float:
    """Read a number from an attribute that an element must have."""
    return number(required_attribute(element, name), element, name)


def vector(text: str | None, element: AnyElement, attribute: str = ''
           ) -> tuple[float, float, float]:
    """Read three numbers, as `numbers` does."""
    x, y, z = numbers(text, 3, element, attribute)
    return x, y, z


def limit_number(text: str | None, element: AnyElement, attribute: str = '') -> float:
    """Read a limit; it is infinite from ``UNLIMITED`` on."""
    try:
        value = c_float((text or '').strip())
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise _error(text, 'a number', element, attribute)
    return math.copysign(math.inf, value) if abs(value) >= UNLIMITED else value


def _error(text: str | None, expected: str, element: AnyElement, attribute: str
           ) -> DescriptionError:
    subject = f'{attribute}=' if attribute else ''
    return DescriptionError(f'{subject}{quoted(text)} is not {expected}', element)


def quoted(text: str | None) -> str:
    """Return a text in quotation marks for a message, shortened if it is long."""
    text = (text or '').strip()
    return repr(text if len(text) <= 60 else f'{text[:57]}...')


def c_float(word: str) -> float:
    """Read a number as C does, without the underscores and foreign digits of Python."""
    if '_' in word or not word.isascii():
        raise ValueError
    return float(word)


def clamped(color: tuple[float, ...]) -> tuple[float, ...]:
    """Return the components of a colour clamped to 0 and 1."""
    return tuple(min(max(component, 0.0), 1.0) for component in color)


def number_text(value: float) -> str:
    """
    Return the text of a number that reads as the same number; an integer has no point.

    Subnormal numbers become 0, because C++ cannot read them.
    """
    if abs(value) < sys.float_info.min:
        value = 0.0
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


def numbers_text(values: tuple[float, ...]) -> str:
    """
    Return the texts of numbers with blanks between them.

    :raises DescriptionError: a number is not finite, because those that it was computed from are
        too large.
    """
    if not all(map(math.isfinite, values)):
        raise DescriptionError('a converted pose or direction is not finite; use smaller numbers')
    return ' '.join(map(number_text, values))


def value_text(value: str | float | tuple[float, ...]) -> str:
    """Return the text of a number or of several numbers; a text is returned unchanged."""
    if isinstance(value, str):
        return value
    return numbers_text(value if isinstance(value, tuple) else (value,))
