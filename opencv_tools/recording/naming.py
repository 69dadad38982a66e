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

"""File names of recorded frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal
import re
from string import Formatter
from typing import Any

from opencv_tools.base.units import NANO

_COPY = re.compile(r'_[0-9]+(\.[^.]*)$')
_MAX_TEXT = 64  # characters of a text in a file name, which may have 255 bytes

# Default format of each field, and a regular expression for its text in any format.
_FIELDS = {
    'seq': ('d', '([0-9]+)'),
    'stamp': ('.9f', '.+?'),
    'sec': ('d', '.+?'),
    'nanosec': ('09d', '.+?'),
    'frame_id': ('s', '.*?'),
    'encoding': ('s', '.*?'),
    'topic': ('s', '.*?'),
}


@dataclass(frozen=True)
class FrameMetadata:
    """
    The metadata of a frame that a file name may contain.

    :param stamp_ns: stamp of the message in nanoseconds.
    :param encoding: encoding of the message, or format string of a compressed message.
    """

    stamp_ns: int
    frame_id: str
    encoding: str
    topic: str

    def values(self, seq: int) -> dict[str, Any]:
        """Return the value of each field; texts have no characters special to paths or shells."""
        sec, nanosec = divmod(self.stamp_ns, NANO)
        return {'seq': seq, 'stamp': Decimal(self.stamp_ns) / NANO, 'sec': sec,
                'nanosec': nanosec, 'frame_id': _sanitize(self.frame_id),
                'encoding': _sanitize(self.encoding), 'topic': _sanitize(self.topic)}


# A number with more digits than a template is likely to ask for.
_SAMPLE = 1234567890
_SAMPLE_METADATA = FrameMetadata(_SAMPLE * NANO, 'camera', 'bgr8', '/video_frames')


class FileNames:
    """File names built from a template such as ``{seq:06d}.png``."""

    def __init__(self, template: str) -> None:
        """
        Check and store the template.

        :param template: file name with any of the fields ``{seq}``, ``{stamp}``, ``{sec}``,
            ``{nanosec}``, ``{frame_id}``, ``{encoding}`` and ``{topic}``, each with an optional
            Python format such as ``{seq:06d}``.
        :raises ValueError: the template is a path, has an unknown field or a bad format.
        """
        self._template = template
        if '/' in template or '\0' in template or template.startswith('.'):
            raise ValueError('give a file name without a folder; output_dir is the folder')
        try:
            self._parts = _template_parts(template)
            self._pattern = re.compile(''.join(
                re.escape(text) if field is None else _FIELDS[field][1]
                for field, text in self._parts))
            sample = self._pattern.fullmatch(self.name(_SAMPLE, _SAMPLE_METADATA))
        except (ValueError, LookupError, TypeError) as err:
            raise ValueError(f'use a template such as {{seq:06d}}.png or {{stamp}}.png; {err}'
                             ) from err
        if not sample or any(int(number) != _SAMPLE for number in sample.groups()):
            raise ValueError('format {seq} as a decimal number, as in {seq:06d}.png')

    @property
    def suffix(self) -> str:
        """File name extension in lower case, with its dot; '' if there is none."""
        stem, dot, suffix = self._template.rpartition('.')
        return f'{dot}{suffix}'.lower() if stem else ''

    @property
    def is_numbered(self) -> bool:
        """Return whether names with different numbers differ."""
        return bool(self._pattern.groups)

    def name(self, seq: int, metadata: FrameMetadata) -> str:
        """Return the file name of a frame, without a folder."""
        values = metadata.values(seq)
        return ''.join(text if field is None else format(values[field], text)
                       for field, text in self._parts)

    def matches(self, name: str) -> bool:
        """Return whether a name may come from this template, including numbered copies."""
        if not self.is_numbered:
            name = _COPY.sub(r'\1', name)
        return self._pattern.fullmatch(name) is not None

    def next_seq(self, names: Iterable[str]) -> int:
        """
        Return the number that follows the highest number in use.

        :param names: names of existing files; names that do not match the template are ignored.
        :returns: highest number plus one; 0 if no name matches.
        """
        if not self.is_numbered:
            return 0
        matches = (self._pattern.fullmatch(name) for name in names)
        return max((int(match[1]) + 1 for match in matches if match), default=0)


def check_folder(path: str) -> None:
    """
    Check that the path of a folder has no fields, which only file names may have.

    :raises ValueError: the path has a field such as ``{topic}``.
    """
    field = re.search(rf'{{(?:{"|".join(_FIELDS)})\b[^{{}}/]*}}', path)
    if field:
        raise ValueError(f'a folder cannot have the field {field[0]}; use it in the file name')


def numbered_copy(name: str, number: int) -> str:
    """Return the name of a numbered copy, such as ``clip_2.mp4`` for ``clip.mp4`` and 2."""
    stem, dot, suffix = name.rpartition('.')
    return f'{stem}_{number}{dot}{suffix}'


def _template_parts(template: str) -> list[tuple[str | None, str]]:
    """Split a template into pairs of field and format, or of None and a literal text."""
    parts: list[tuple[str | None, str]] = []
    for literal, field, spec, conversion in Formatter().parse(template):
        parts.append((None, literal))
        if field is None:
            continue
        if field not in _FIELDS or conversion:
            raise ValueError(f'the field {{{field}}} is unknown; the fields are '
                             f'{", ".join(f"{{{known}}}" for known in _FIELDS)}')
        parts.append((field, spec or _FIELDS[field][0]))
    return parts


def _sanitize(text: str) -> str:
    """Return a text of a message with only characters that are safe in a file name."""
    plain = re.sub(r'[^A-Za-z0-9._-]', '_', text.strip('/')[:_MAX_TEXT])
    return re.sub(r'^[.-]', '_', plain) or '_'
