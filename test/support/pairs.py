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

"""Covering arrays: few combinations of values in which all small combinations occur."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
import itertools
import random

#: Value of each factor.
Combination = Mapping[str, str]
#: Values of some factors, in the order of their names.
Part = tuple[tuple[str, str], ...]

_CANDIDATES = 100  # combinations that are compared before one is chosen


def parts(combination: Combination, strength: int) -> set[Part]:
    """Return the values of each group of factors, of which a pair has two."""
    return set(itertools.combinations(sorted(combination.items()), strength))


def allowed_combinations(
        factors: Mapping[str, Sequence[str]], excluded: Iterable[Part],
) -> list[Combination]:
    """Return all combinations that contain no excluded part."""
    forbidden = [set(part) for part in excluded]
    everything = (dict(zip(factors, values)) for values in itertools.product(*factors.values()))
    return [combination for combination in everything
            if not any(part <= combination.items() for part in forbidden)]


def covering_array(
        allowed: Sequence[Combination], strength: int, seed: int, also: Sequence[Part] = (),
) -> list[Combination]:
    """
    Choose combinations in which every part occurs that occurs in any combination.

    :param allowed: the combinations to choose from.
    :param strength: number of factors of a part.
    :param seed: seed of the choice; each one leads to another array.
    :param also: further parts that must occur.
    """
    chance = random.Random(seed)
    rows = [sorted(combination.items()) for combination in allowed]
    missing = sorted({part for columns in itertools.combinations(zip(*rows), strength)
                      for part in set(zip(*columns))})
    indexes = _indexes(allowed)
    parts_of = cache(lambda index: {*itertools.combinations(rows[index], strength)})
    wanted = list(also)
    array: list[Combination] = []
    while wanted or missing:
        part = wanted.pop() if wanted else chance.choice(missing)
        having = sorted(set.intersection(*(indexes[value] for value in part)))
        candidates = chance.sample(having, min(_CANDIDATES, len(having)))
        remaining = set(missing)
        best = max(candidates, key=lambda index: len(parts_of(index) & remaining))
        missing = [part for part in missing if part not in parts_of(best)]
        array.append(allowed[best])
    return array


def _indexes(combinations: Iterable[Combination]) -> dict[tuple[str, str], set[int]]:
    """Return the indexes of the combinations that have a value."""
    found: dict[tuple[str, str], set[int]] = {}
    for index, combination in enumerate(combinations):
        for value in combination.items():
            found.setdefault(value, set()).add(index)
    return found
