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
Shapes of the messages between the pages and the server.

tsc checks the pages against messages.d.ts, and ``problems`` each message that a test reads.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
import re
from typing import Any

FILE = Path(__file__).parents[2] / 'opencv_tools' / 'viewer' / 'messages.d.ts'
_PLAIN: dict[str, tuple[type, ...]] = {
    'string': (str,), 'number': (int, float), 'boolean': (bool,), 'null': (type(None),)}
_INTERFACE = re.compile(r'^export interface (\w+)(?: extends (\w+))? \{\n(.*?)^\}', re.M | re.S)
_FIELD = re.compile(r'(\w+)(\??): (.*);\n')


@cache
def shapes() -> dict[str, dict[str, tuple[str, bool]]]:
    """Return the type of each field and whether it is optional, by the name of the shape."""
    found: dict[str, dict[str, tuple[str, bool]]] = {}
    for name, base, body in _INTERFACE.findall(FILE.read_text()):
        found[name] = found.get(base, {}) | {
            field: (kind, bool(mark)) for field, mark, kind in _FIELD.findall(body)}
    return found


def problems(value: Any, kind: str, place: str = '') -> list[str]:
    """Return what is wrong with a value of JSON that shall have a type; nothing if it has it."""
    kind = kind.strip()
    choices = _split(kind, '|')
    if len(choices) > 1:
        found = [problems(value, choice, place) for choice in choices]
        return min(found, key=len)
    if kind == 'any':
        return []
    if kind in _PLAIN:
        is_one = isinstance(value, _PLAIN[kind]) and (
            kind == 'boolean' or not isinstance(value, bool))
        return [] if is_one else [f'{place}: {value!r} is not {kind}']
    return _problems_inside(value, kind, place)


def _problems_inside(value: Any, kind: str, place: str) -> list[str]:
    if kind.startswith('(') and kind.endswith(')'):
        return problems(value, kind[1:-1], place)
    if kind.endswith('[]'):
        kinds = [kind[:-2]] * len(value) if isinstance(value, list) else []
        return _all(value, kinds, place)
    if kind.startswith('['):
        return _all(value, _split(kind[1:-1], ','), place)
    if record := re.fullmatch(r'Record<string, (.*)>', kind):
        return [text for name, one in value.items()
                for text in problems(one, record[1], f'{place}.{name}')]
    fields = shapes()[kind]
    if not isinstance(value, dict):
        return [f'{place}: {value!r} is not {kind}']
    missing = [f'{place}.{name} is missing' for name, (_, is_optional) in fields.items()
               if not is_optional and name not in value]
    return missing + [text for name, one in value.items() for text in (
        problems(one, fields[name][0], f'{place}.{name}') if name in fields
        else [f'{place}.{name} is not in {kind}'])]


def _all(values: Any, kinds: list[str], place: str) -> list[str]:
    if not isinstance(values, list) or len(values) != len(kinds):
        return [f'{place}: {values!r} is no list of {len(kinds)}']
    return [text for number, (value, kind) in enumerate(zip(values, kinds, strict=True))
            for text in problems(value, kind, f'{place}[{number}]')]


def _split(kind: str, mark: str) -> list[str]:
    """Split a type at a mark that is outside of brackets."""
    parts, depth = [''], 0
    for sign in kind:
        depth += (sign in '([{<') - (sign in ')]}>')
        if sign == mark and not depth:
            parts.append('')
        else:
            parts[-1] += sign
    return parts
