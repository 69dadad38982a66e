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

"""The controls of a V4L2 camera, such as its brightness."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
import enum
from fcntl import ioctl

from opencv_tools.base.text import printable
from opencv_tools.capture.v4l2 import videodev2
from opencv_tools.capture.v4l2.videodev2 import try_ioctl

_UNUSABLE = (videodev2.V4L2_CTRL_FLAG_DISABLED | videodev2.V4L2_CTRL_FLAG_READ_ONLY
             | videodev2.V4L2_CTRL_FLAG_WRITE_ONLY)

# Events that are read in one call. The limit ends the loop when another program changes controls
# without pause. The kernel queues one event a control.
_EVENTS = 1000


class ControlType(enum.IntEnum):
    """The values of ``enum v4l2_ctrl_type`` for controls with a single number."""

    INTEGER = 1
    BOOLEAN = 2
    MENU = 3
    INTEGER_MENU = 9


@dataclass(frozen=True, kw_only=True)
class Control:
    """
    A control of a camera, such as its brightness.

    :param name: name from the driver, in lower case with underscores.
    :param number: V4L2 control ID.
    :param step: difference between neighbouring values; may be 0.
    :param default: the driver's default value.
    :param choices: value and text of each menu entry; empty unless the control is a menu.
    :param active: False while the camera sets the value itself, for example in automatic mode.
    """

    name: str
    number: int
    kind: ControlType
    minimum: int
    maximum: int
    step: int
    default: int
    choices: tuple[tuple[int, str], ...] = ()
    active: bool = field(default=True, compare=False)

    @property
    def remedy(self) -> str:
        """Sentence with the valid values, for the user."""
        return f'give a number from {self.minimum} to {self.maximum}'


def list_controls(fd: int) -> Iterator[Control]:
    """
    Yield the controls of a device that can be read and written and have a single number.

    Subscribes to the changes of each control, which ``changed_controls`` then yields.

    :raises OSError: the device is disconnected.
    """
    query = videodev2.v4l2_query_ext_ctrl(id=videodev2.V4L2_CTRL_FLAG_NEXT_CTRL)
    while try_ioctl(fd, videodev2.VIDIOC_QUERY_EXT_CTRL, query):
        if _is_usable(query):
            with suppress(OSError):  # the driver may not support events
                ioctl(fd, videodev2.VIDIOC_SUBSCRIBE_EVENT, videodev2.v4l2_event_subscription(
                    videodev2.V4L2_EVENT_CTRL, query.id,
                    videodev2.V4L2_EVENT_SUB_FL_ALLOW_FEEDBACK))
            yield _describe_control(fd, query)
        query.id |= videodev2.V4L2_CTRL_FLAG_NEXT_CTRL


def changed_controls(fd: int) -> Iterator[Control]:
    """
    Yield the controls that any program has changed since the last call.

    :param fd: descriptor of an open device on which ``list_controls`` has run.
    :raises OSError: the device is disconnected.
    """
    numbers: dict[int, None] = {}
    with suppress(FileNotFoundError):  # ENOENT: no event is left
        for _ in range(_EVENTS):
            event = videodev2.v4l2_event()
            if not try_ioctl(fd, videodev2.VIDIOC_DQEVENT, event):
                break
            if event.type == videodev2.V4L2_EVENT_CTRL:
                numbers[event.id] = None
    for number in numbers:
        query = videodev2.v4l2_query_ext_ctrl(id=number)
        if try_ioctl(fd, videodev2.VIDIOC_QUERY_EXT_CTRL, query) and _is_usable(query):
            yield _describe_control(fd, query)


def _is_usable(query: videodev2.v4l2_query_ext_ctrl) -> bool:
    return query.type in list(ControlType) and not query.flags & _UNUSABLE


def _describe_control(fd: int, query: videodev2.v4l2_query_ext_ctrl) -> Control:
    name = ''.join(char if char.isalnum() else ' ' for char in query.name.decode('latin-1'))
    kind = ControlType(query.type)
    return Control(
        name='_'.join(name.lower().split()), number=query.id, kind=kind, minimum=query.minimum,
        maximum=query.maximum, step=query.step, default=query.default_value,
        choices=tuple(_menu(fd, query)) if 'MENU' in kind.name else (),
        active=not query.flags & videodev2.V4L2_CTRL_FLAG_INACTIVE)


def _menu(fd: int, query: videodev2.v4l2_query_ext_ctrl) -> Iterator[tuple[int, str]]:
    """Yield the value and the text of each entry of a menu."""
    for index in range(query.minimum, query.maximum + 1):
        entry = videodev2.v4l2_querymenu(id=query.id, index=index)
        if try_ioctl(fd, videodev2.VIDIOC_QUERYMENU, entry):
            if query.type == ControlType.INTEGER_MENU:
                raw = bytes(entry)[8:16]
                yield index, str(int.from_bytes(raw, 'little', signed=True))
            else:
                yield index, printable(entry.name.decode('latin-1'))
