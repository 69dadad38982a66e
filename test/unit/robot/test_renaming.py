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

from opencv_tools.robot.names import Names


def test_free_name_is_kept() -> None:
    names = Names()
    assert (names.kept('a', '_link'), names.new('b')) == ('a', 'b')
    assert 'a' in names and 'b' in names


def test_taken_name_gets_the_first_free_number() -> None:
    names = Names({'a', 'a_1', 'a_3'})
    assert [names.new('a') for _ in range(3)] == ['a_2', 'a_4', 'a_5']
    assert names.kept('a', '_link') == 'a_link'
    assert names.kept('a', '_link') == 'a_link_1'


def test_taken_names_are_not_tried_again() -> None:
    names = Names({'a', *(f'a_{number}' for number in range(1, 100))})
    assert names.new('a') == 'a_100'
    tried: list[object] = []

    class Counting(set[str]):

        def __contains__(self, name: object) -> bool:
            tried.append(name)
            return super().__contains__(name)

    names._taken = Counting(names._taken)
    assert names.new('a') == 'a_101'
    assert tried == ['a_101']
