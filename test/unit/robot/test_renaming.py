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

from opencv_tools.robot.renaming import unique_name


def test_free_name_is_kept() -> None:
    assert unique_name('a', set()) == 'a'


def test_taken_name_gets_the_first_free_number() -> None:
    assert unique_name('a', {'a', 'a_1', 'a_3'}) == 'a_2'


class Names(set[str]):
    """Names that count the look-ups."""

    lookups = 0

    def __contains__(self, name: object) -> bool:
        self.lookups += 1
        return super().__contains__(name)


def test_names_that_were_tried_are_not_tried_again() -> None:
    taken, counts = Names({'a'}), {'b': 0}
    for _ in range(100):
        taken.add(unique_name('a', taken, counts))
    assert taken == {'a', *(f'a_{number}' for number in range(1, 101))}
    assert taken.lookups == 101
