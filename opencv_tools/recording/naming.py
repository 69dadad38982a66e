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

"""Names of the files that frames are written to."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal
import re
from string import Formatter
from typing import Any

NANO = 10**9  # nanoseconds in a second
_COPY = re.compile(r'_[0-9]+(\.[^.]*)$')
_MAX_TEXT = 64  # of a name of 255 bytes

# How each field is written when the template does not say, and what matches it in any form.
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
class Labels:
    """
    What the name of a file can tell of its frame, beside a number.

    :param stamp_ns: the stamp of the message in nanoseconds.
    :param frame_id: the coordinate frame of the message.
    :param encoding: the encoding of the message, or its format when it is compressed.
    :param topic: the topic that it came from.
    """

    stamp_ns: int
    frame_id: str
    encoding: str
    topic: str

    def values(self, seq: int) -> dict[str, Any]:
        """Give the value of each field, texts without what a path or a shell could mean by it."""
        sec, nanosec = divmod(self.stamp_ns, NANO)
        return {'seq': seq, 'stamp': Decimal(self.stamp_ns) / NANO, 'sec': sec,
                'nanosec': nanosec, 'frame_id': _harmless(self.frame_id),
                'encoding': _harmless(self.encoding), 'topic': _harmless(self.topic)}


# Longer than any width that a template is likely to ask for.
_SAMPLE = 1234567890
_SAMPLE_LABELS = Labels(_SAMPLE * NANO, 'camera', 'bgr8', '/video_frames')


class FileNames:
    """Names of files, made by a template such as ``{seq:06d}.png``."""

    def __init__(self, template: str) -> None:
        """
        Check the template.

        :param template: a file name with any of the fields ``{seq}``, ``{stamp}``, ``{sec}``,
            ``{nanosec}``, ``{frame_id}``, ``{encoding}`` and ``{topic}``, with a layout as Python
            has it.
        :raises ValueError: it is a path, or has another field, or cannot be formatted.
        """
        self._template = template
        if '/' in template or '\0' in template or template.startswith('.'):
            raise ValueError('write a file name, not a path; the folder is output_dir')
        try:
            self._parts = _template_parts(template)
            self._pattern = _template_pattern(self._parts)
            sample = self._pattern.fullmatch(self.name(_SAMPLE, _SAMPLE_LABELS))
        except (ValueError, LookupError, TypeError) as err:
            raise ValueError(f'write a name such as {{seq:06d}}.png or {{stamp}}.png; {err}'
                             ) from err
        if not sample or any(int(number) != _SAMPLE for number in sample.groups()):
            raise ValueError('write {seq} as a decimal number, as in {seq:06d}.png')

    @property
    def suffix(self) -> str:
        """Give the extension in lower case, with its dot; empty when there is none."""
        stem, dot, suffix = self._template.rpartition('.')
        return f'{dot}{suffix}'.lower() if stem else ''

    @property
    def is_numbered(self) -> bool:
        """Tell whether another number makes another name."""
        return bool(self._pattern.groups)

    def name(self, seq: int, labels: Labels) -> str:
        """Give the name of the file of a frame, a whole one without any folder."""
        values = labels.values(seq)
        return ''.join(text if field is None else format(values[field], text)
                       for field, text in self._parts)

    def matches(self, name: str) -> bool:
        """Tell whether the template may have made a name, or that of a copy."""
        if not self.is_numbered:
            name = _COPY.sub(r'\1', name)
        return self._pattern.fullmatch(name) is not None

    def next_seq(self, names: Iterable[str]) -> int:
        """
        Give the number that follows those in use.

        :param names: the files there are; those that the template does not make are passed over.
        :returns: one more than the highest number, 0 when there is none.
        """
        if not self.is_numbered:
            return 0
        matches = (self._pattern.fullmatch(name) for name in names)
        return max((int(match[1]) + 1 for match in matches if match), default=0)


def numbered_copy(name: str, number: int) -> str:
    """Give the name of another file of the same name: ``clip_2.mp4`` for ``clip.mp4`` and 2."""
    stem, dot, suffix = name.rpartition('.')
    return f'{stem}_{number}{dot}{suffix}'


def _template_parts(template: str) -> list[tuple[str | None, str]]:
    """Take a template apart: the field and how it is formatted, or None and a literal text."""
    parts: list[tuple[str | None, str]] = []
    for literal, field, layout, conversion in Formatter().parse(template):
        parts.append((None, literal))
        if field is None:
            continue
        if field not in _FIELDS or conversion:
            raise ValueError(f'there is no field {{{field}}}, but there are '
                             f'{", ".join(f"{{{known}}}" for known in _FIELDS)}')
        parts.append((field, layout or _FIELDS[field][0]))
    return parts


def _template_pattern(parts: Iterable[tuple[str | None, str]]) -> re.Pattern[str]:
    """Make the regular expression that the names of a template match, with a group a number."""
    return re.compile(''.join(
        re.escape(text) if field is None else _FIELDS[field][1] for field, text in parts))


def _harmless(text: str) -> str:
    """Make a text that a message brought a part of a file name, and of nothing else."""
    plain = re.sub(r'[^A-Za-z0-9._-]', '_', text.strip('/')[:_MAX_TEXT])
    return re.sub(r'^[.-]', '_', plain) or '_'
