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

"""The settings of a V4L2 camera, such as its brightness."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from opencv_tools.capture import videodev
from opencv_tools.capture.videodev import ask_about, ControlType


@dataclass(frozen=True)
class Control:
    """
    A setting of a camera, such as its brightness.

    :param name: as the driver names it, in lower case with underscores.
    :param number: the kernel's number for it.
    :param kind: what its value is.
    :param choices: of a menu what each number means.
    """

    name: str
    number: int
    kind: ControlType
    minimum: int
    maximum: int
    step: int
    default: int
    choices: tuple[tuple[int, str], ...] = ()

    @property
    def remedy(self) -> str:
        """Say what values can be given."""
        return f'give a number from {self.minimum} to {self.maximum}'


def list_controls(fd: int) -> Iterator[Control]:
    """
    Give the settings of an open device that can be read and changed and are one number.

    :raises OSError: the device is gone.
    """
    query = videodev.ControlQuery(id=videodev.NEXT_CONTROL)
    unusable = (videodev.CONTROL_IS_DISABLED | videodev.CONTROL_IS_READ_ONLY
                | videodev.CONTROL_IS_WRITE_ONLY)
    while ask_about(fd, videodev.QUERY_EXT_CTRL, query):
        if query.type in list(ControlType) and not query.flags & unusable:
            yield _describe_control(fd, query)
        query.id |= videodev.NEXT_CONTROL


def _describe_control(fd: int, query: videodev.ControlQuery) -> Control:
    name = ''.join(char if char.isalnum() else ' ' for char in query.name.decode('latin-1'))
    kind = ControlType(query.type)
    return Control(
        '_'.join(name.lower().split()), query.id, kind, query.minimum, query.maximum, query.step,
        query.default_value, tuple(_menu(fd, query)) if 'MENU' in kind.name else ())


def _menu(fd: int, query: videodev.ControlQuery) -> Iterator[tuple[int, str]]:
    """Give the entries that a menu has, number and text."""
    for index in range(query.minimum, query.maximum + 1):
        entry = videodev.MenuQuery(id=query.id, index=index)
        if ask_about(fd, videodev.QUERYMENU, entry):
            if query.type == ControlType.INTEGER_MENU:
                raw = bytes(entry)[8:16]
                yield index, str(int.from_bytes(raw, 'little', signed=True))
            else:
                yield index, entry.name.decode('latin-1')
