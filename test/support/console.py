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

"""A log that keeps its lines."""

from __future__ import annotations

from opencv_tools.base.logs import Log


class _Writer:

    def __init__(self) -> None:
        self.lines: list[str] = []

    def debug(self, message: str) -> None:
        self.lines.append(f'debug: {message}')

    def info(self, message: str) -> None:
        self.lines.append(f'info: {message}')

    def warning(self, message: str) -> None:
        self.lines.append(f'warning: {message}')

    def error(self, message: str) -> None:
        self.lines.append(f'error: {message}')


class Console(Log):
    """A log that keeps its lines, each after its level."""

    def __init__(self) -> None:
        writer = _Writer()
        self.lines = writer.lines
        super().__init__(writer)
