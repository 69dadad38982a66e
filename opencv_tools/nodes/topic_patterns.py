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

"""Patterns of the names of topics, in which ``*`` stands for any characters."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
import re

from opencv_tools.base.text import printable

# What a slash separates is not empty and begins with no digit.
_PATTERN = re.compile(r'(?!.*(//|/[0-9]|/$))[/*][A-Za-z0-9_/*]*')


def check_patterns(text: str) -> None:
    """
    Check patterns with blanks between them.

    :raises ValueError: one of them can match no topic.
    """
    for pattern in text.split():
        if not _PATTERN.fullmatch(pattern):
            raise ValueError(f'{printable(pattern)} is no name of a topic; give names such as /tf '
                             'and /camera/*, with / at their begin')


def matches(name: str, patterns: Sequence[str]) -> bool:
    """Return whether a name matches any of some patterns."""
    return any(fnmatchcase(name, pattern) for pattern in patterns)
