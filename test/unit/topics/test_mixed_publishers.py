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

"""The warning that several publishers send frames on one topic."""

from __future__ import annotations

from collections.abc import Iterable, Set

from opencv_tools.base.logs import Log
from opencv_tools.topics.subscription import MixedPublishers
import pytest

OLD, NEW, THIRD = b'old', b'new', b'third'


class Warnings(Log):
    """A log that keeps its warnings."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def warning(self, message: str) -> None:
        self.texts.append(message)


def describe(publishers: Set[bytes]) -> str:
    """Return the names of publishers."""
    return f'nodes {sorted(publisher.decode() for publisher in publishers)}'


def warnings(checks: Iterable[dict[bytes, int]]) -> list[str]:
    """Return the warnings after checks with numbers of frames by publisher."""
    log = Warnings()
    mixed = MixedPublishers(log, describe)
    for counts in checks:
        mixed.check('/image', counts)
    return log.texts


@pytest.mark.parametrize('checks', [
    [{OLD: 10}, {OLD: 20}, {OLD: 30}],
    [{OLD: 10}, {OLD: 12, NEW: 8}, {OLD: 12, NEW: 18}, {OLD: 12, NEW: 28}],  # starts again
    [{OLD: 10, NEW: 10}, {OLD: 20, NEW: 10}, {OLD: 20, NEW: 20}],  # in turn
])
def test_one_publisher_at_a_time(checks: list[dict[bytes, int]]) -> None:
    assert warnings(checks) == []


def test_publishers_whose_frames_are_mixed() -> None:
    checks = [{OLD: count, NEW: count} for count in range(1, 6)]
    text = "publishers on /image: nodes ['new', 'old']; their frames are mixed"
    assert warnings(checks) == [f'2 {text}']
    assert warnings(checks[:1]) == []
    third = [{**counts, THIRD: number} for number, counts in enumerate(checks)]
    assert warnings([*checks, *({name: count + 9 for name, count in counts.items()}
                                for counts in third)]) == [
        f'2 {text}',
        "3 publishers on /image: nodes ['new', 'old', 'third']; their frames are mixed"]
