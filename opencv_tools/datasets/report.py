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

"""The account of the topics of a set: which samples are in it, and how well their times fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from opencv_tools.image.text import printable


def topic_lines(parts: Sequence[Mapping[str, Any]]) -> list[str]:
    """
    Return a sentence for each topic.

    :param parts: what part.json says of the bags. The median is the largest one of all bags.
    """
    lines = []
    for name in parts[0]['topics']:
        found = [part['topics'][name] for part in parts if name in part['topics']]
        sums = {key: sum(one[key] for one in found) for key in ('used', 'reused', 'dropped')}
        worst = {key: 1000 * max(one[key] for one in found)
                 for key in ('median_error', 'largest_error')}
        lines.append(
            f'{printable(name)}: {sums["used"]} samples used, {sums["reused"]} rows repeat one, '
            f'{sums["dropped"]} dropped; from sample to row {worst["median_error"]:.1f} ms in the '
            f'median, {worst["largest_error"]:.1f} ms at most')
    return lines
