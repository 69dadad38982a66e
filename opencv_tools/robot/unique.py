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

"""Names that no other element has."""

from __future__ import annotations

from collections.abc import Container


def unique_name(base: str, taken: Container[str], counts: dict[str, int] | None = None) -> str:
    """
    Return a name that is not taken: the base name, or else the base name with a number from 1.

    :param counts: how many names of each base were tried; it is updated. A dictionary that is
        kept between calls avoids trying the same names again, which is slow for many of them.
    """
    counts = {} if counts is None else counts
    while True:
        count = counts.get(base, 0)
        counts[base] = count + 1
        name = f'{base}_{count}' if count else base
        if name not in taken:
            return name
