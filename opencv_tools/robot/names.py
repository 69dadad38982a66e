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

"""Names that are unique, and names that SDF allows."""

from __future__ import annotations

from collections.abc import Iterable


class Names:
    """Names that are taken, and new ones that differ from them and from each other."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = set(taken)
        # How many names of each base were tried, because it is slow to try many again.
        self._counts: dict[str, int] = {}

    def __contains__(self, name: str) -> bool:
        return name in self._taken

    def add(self, name: str) -> None:
        """Take a name."""
        self._taken.add(name)

    def new(self, base: str) -> str:
        """Take the base name, or else the base name with a number from 1, and return it."""
        while True:
            count = self._counts.get(base, 0)
            self._counts[base] = count + 1
            name = f'{base}_{count}' if count else base
            if name not in self._taken:
                self.add(name)
                return name

    def kept(self, name: str, suffix: str) -> str:
        """Take a name, or else a new one of the name with a suffix, and return it."""
        if name in self._taken:
            return self.new(name + suffix)
        self.add(name)
        return name


def flat_name(name: str) -> str:
    """Return a name of a nested model without ``::``."""
    return name.replace('::', '__')


def allowed_name(name: str) -> str:
    """Return a name without ``::`` and without the form ``__name__``, which SDF reserves."""
    name = flat_name(name)
    if len(name) > 3 and name.startswith('__') and name.endswith('__'):
        name = name.strip('_') or 'unnamed'
    return name
