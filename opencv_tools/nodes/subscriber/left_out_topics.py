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

"""Topics that match, but cannot be recorded."""

from __future__ import annotations

from collections.abc import Container

from opencv_tools.logs import Log

_MAX_LOGGED = 1000  # reasons


class LeftOutTopics:
    """
    Log once why a topic is not recorded, and again after a change of its publishers.

    Only topics that exist are remembered.
    """

    def __init__(self, log: Log) -> None:
        """Begin without topics."""
        self._log = log
        self._publishers: dict[str, frozenset[bytes]] = {}
        self._logged = 0

    def keep(self, names: Container[str]) -> None:
        """Forget all topics but those with some names."""
        self._publishers = {
            name: publishers for name, publishers in self._publishers.items() if name in names}

    def has(self, name: str, publishers: frozenset[bytes]) -> bool:
        """Return whether a topic was added with the same publishers."""
        return self._publishers.get(name) == publishers

    def add(self, name: str, publishers: frozenset[bytes], shown: str, reason: str) -> None:
        """
        Add a topic.

        :param name: name of the topic.
        :param publishers: identifiers of its publishers.
        :param shown: what is not recorded, for the log.
        :param reason: why.
        """
        if self.has(name, publishers):
            return
        self._publishers[name] = publishers
        self._logged += 1
        if self._logged <= _MAX_LOGGED:
            self._log.warning(f'{shown} is not recorded: {reason}')
        else:
            self._log.warning(
                f'more than {_MAX_LOGGED} topics are not recorded; further reasons are not logged',
                once='topics left out')
