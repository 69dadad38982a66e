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
import re
from string import Formatter

_SAMPLE = 1234567890  # longer than any width that a template is likely to ask for


class FileNames:
    """Numbered file names, made by a template such as ``{seq:06d}.png``."""

    def __init__(self, template: str) -> None:
        """
        Check the template.

        :param template: a file name with the field ``{seq}``, formatted as Python does.
        :raises ValueError: it is a path, has no or another field, or makes no number of it.
        """
        self._template = template
        if '/' in template or template.startswith('.'):
            raise ValueError('write a file name, not a path; the folder is output_dir')
        try:
            self._pattern = _template_pattern(template)
            sample = self._pattern.fullmatch(self.name(_SAMPLE))
        except (ValueError, LookupError, TypeError) as err:
            raise ValueError(f'write a name with {{seq}} in it, as in {{seq:06d}}.png; {err}'
                             ) from err
        if not sample or any(int(number) != _SAMPLE for number in sample.groups()):
            raise ValueError('write {seq} as a decimal number, as in {seq:06d}.png')

    @property
    def suffix(self) -> str:
        """Give the extension in lower case, with its dot; empty when there is none."""
        stem, dot, suffix = self._template.rpartition('.')
        return f'{dot}{suffix}'.lower() if stem else ''

    def name(self, seq: int) -> str:
        """Give the name of the file with a number."""
        return self._template.format(seq=seq)

    def next_seq(self, names: Iterable[str]) -> int:
        """
        Give the number that follows those in use.

        :param names: the files there are; those that the template does not make are passed over.
        :returns: one more than the highest number, 0 when there is none.
        """
        matches = (self._pattern.fullmatch(name) for name in names)
        return max((int(match[1]) + 1 for match in matches if match), default=0)


def _template_pattern(template: str) -> re.Pattern[str]:
    """Make the regular expression that the names of a template match, with a group a number."""
    expression = ''
    fields = 0
    for literal, field, _, _ in Formatter().parse(template):
        expression += re.escape(literal)
        if field is None:
            continue
        if field != 'seq':
            raise ValueError(f'there is no field {{{field}}}')
        expression += '([0-9]+)'
        fields += 1
    if not fields:
        raise ValueError('without it every frame would overwrite the one before')
    return re.compile(expression)
