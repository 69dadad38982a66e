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

"""
The announcement of frames in shared memory, on the topic ``<image topic>/shm``.

It is a JSON object in a std_msgs/String with durability transient local. Subscribers on another
host, in another container or of another user see from it that they must use the image topic.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
import json
import os
from pathlib import Path
import re

from opencv_tools.transport.shared_frames.memory import SHARED_MEMORY

#: Suffix of the topic.
SUFFIX = '/shm'
_VERSION = 2
_MAX_BYTES = 4096
_MAX_NUMBER = 2**48
_IDENTIFIER = re.compile(r'[0-9a-f]{32}')
_PLACE = re.compile(r'[0-9a-f-]{1,64}')


class AnnouncementError(ValueError):
    """An announcement is malformed; the text is the reason."""


@dataclass(frozen=True)
class Announcement:
    """
    Where the frames of a publisher are.

    :param service: name of the service; '' if the publisher has stopped sharing.
    :param memory: device number of /dev/shm, which differs between containers.
    :param publisher: identifier of the publisher of the image topic, 32 hexadecimal digits.
    :param frames: number of frames published until now.
    """

    service: str
    boot: str
    memory: int
    user: int
    publisher: str
    frames: int = 0
    messages: int = 0

    @property
    def is_reachable(self) -> bool:
        """Whether this process can open the service."""
        return bool(self.service) and self == announce(
            self.service, self.publisher, self.frames, self.messages)

    def to_text(self) -> str:
        """Return the announcement as JSON."""
        return json.dumps({'version': _VERSION, **asdict(self)})


def announce(
    service: str, publisher: str, frames: int = 0, messages: int = 0,
) -> Announcement:
    """Return the announcement of a service of this process; see `Announcement`."""
    boot = Path('/proc/sys/kernel/random/boot_id').read_text().strip()
    return Announcement(service, boot, SHARED_MEMORY.stat().st_dev, os.getuid(), publisher,
                        frames, messages)


def read_announcement(text: str) -> Announcement:
    """
    Read an announcement from a message of unknown origin.

    :raises AnnouncementError: it is malformed or of another version.
    """
    if len(text) > _MAX_BYTES:
        raise AnnouncementError(f'the announcement has {len(text)} characters; the limit is '
                                f'{_MAX_BYTES}')
    try:
        fields = json.loads(text)
    except (ValueError, RecursionError) as err:
        raise AnnouncementError(f'the announcement is not JSON: {err}') from err
    if not isinstance(fields, dict) or fields.get('version') != _VERSION:
        raise AnnouncementError(f'the announcement does not have version {_VERSION}')
    service, boot = fields.get('service'), fields.get('boot')
    memory, user = fields.get('memory'), fields.get('user')
    if not isinstance(service, str) or (
            service and not _IDENTIFIER.fullmatch(service)):
        raise AnnouncementError('the announcement has an invalid service')
    if not isinstance(boot, str) or not _PLACE.fullmatch(boot):
        raise AnnouncementError('the announcement has an invalid boot identifier')
    if type(memory) is not int or type(user) is not int:
        raise AnnouncementError('the announcement has an invalid memory or user')
    publisher = fields.get('publisher')
    if not isinstance(publisher, str) or not _IDENTIFIER.fullmatch(publisher):
        raise AnnouncementError('the announcement has an invalid publisher')
    frames, messages = fields.get('frames'), fields.get('messages')
    if (type(frames) is not int or type(messages) is not int
            or not 0 <= messages <= frames <= _MAX_NUMBER):
        raise AnnouncementError('the announcement has invalid numbers of frames and messages')
    return Announcement(service, boot, memory, user, publisher, frames, messages)
