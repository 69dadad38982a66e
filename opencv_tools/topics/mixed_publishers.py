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

"""Warning when the frames of several publishers are mixed on one topic."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set

from opencv_tools.logs import Log

# Successive checks with frames of several publishers. A publisher that starts again overlaps with
# its former one for one check.
_CHECKS = 2


class MixedPublishers:
    """Log once that several publishers send frames on a topic, and of which nodes they are."""

    def __init__(self, log: Log, describe: Callable[[Set[bytes]], str]) -> None:
        """
        Create a warning.

        :param describe: returns the names of the nodes of some publishers.
        """
        self._log = log
        self._describe = describe
        self._counts: dict[bytes, int] = {}
        self._checks = 0
        self._logged: frozenset[bytes] = frozenset()

    def check(self, topic: str, counts: Mapping[bytes, int]) -> None:
        """
        Log a warning if several publishers have sent frames in the last checks.

        :param counts: number of frames by publisher until now.
        """
        active = frozenset(
            publisher for publisher, count in counts.items()
            if count > self._counts.get(publisher, 0))
        self._counts = dict(counts)
        self._checks = self._checks + 1 if len(active) > 1 else 0
        if self._checks >= _CHECKS and not active <= self._logged:
            self._logged = active
            self._log.warning(f'{len(active)} publishers on {topic}: {self._describe(active)}; '
                              'their frames are mixed')
