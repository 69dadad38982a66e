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

"""The definitions of the compiled message types, as ROS has installed them."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from ament_index_python import get_packages_with_prefixes
import numpy as np
from opencv_tools.message_types.definition import (
    Array, Field, PLACEHOLDER, read_definition, TypeDefinition)

SEPARATOR = f'\n{"=" * 80}\nMSG: '
_RANGES = {'bool': (0, 1), 'byte': (0, 255), 'char': (0, 255), 'int8': (-128, 127),
           'uint8': (0, 255), 'int16': (-2**15, 2**15 - 1), 'uint16': (0, 2**16 - 1),
           'int32': (-2**31, 2**31 - 1), 'uint32': (0, 2**32 - 1), 'int64': (-2**63, 2**63 - 1),
           'uint64': (0, 2**64 - 1)}


@cache
def installed_texts() -> dict[str, str]:
    """Return the text of each .msg file by the name of the type."""
    return {f'{package}/msg/{path.stem}': path.read_text()
            for package, prefix in get_packages_with_prefixes().items()
            for path in sorted(Path(prefix, 'share', package, 'msg').glob('*.msg'))}


def compiled_class(name: str) -> Any:
    """Return the class of a compiled type, ready for use."""
    package, _, short = name.split('/')
    found = getattr(import_module(f'{package}.msg'), short)
    if type(found)._TYPE_SUPPORT is None:
        type(found).__import_type_support__()
    return found


def whole_text(name: str) -> str:
    """Return the text of a type, with those of the types that it contains."""
    texts = installed_texts()
    needed = [name]
    for current in needed:
        package = current.partition('/')[0]
        for line in texts[current].splitlines():
            base = line.partition('#')[0].partition(' ')[0].partition('[')[0]
            other = ('/msg/'.join(base.split('/')) if '/' in base else f'{package}/msg/{base}')
            if other in texts and other not in needed:
                needed.append(other)
    return SEPARATOR.join([texts[name], *(
        f'{other}\n{texts[other]}' for other in needed[1:])])


def installed_type(name: str) -> TypeDefinition:
    """Read the definition of a compiled type."""
    return read_definition(name, whole_text(name))


def random_message(
    definition: TypeDefinition, name: str, random: np.random.Generator,
) -> dict[str, Any]:
    """Return a message with a value in each field."""
    def value(field: Field) -> Any:
        if field.is_message:
            return random_message(definition, field.base, random)
        if field.base == 'string':
            return ''.join(random.choice([*'aé{ 漢'], random.integers(0, 9)))
        if field.base in ('float32', 'float64'):
            return float(np.float32(random.normal()))
        low, high = _RANGES[field.base]
        found = int(random.integers(low, high, endpoint=True, dtype=field.base if field.base
                                    not in ('bool', 'byte', 'char') else 'uint8'))
        return bool(found) if field.base == 'bool' else found

    def values(field: Field) -> Any:
        if field.array is Array.NONE:
            return value(field)
        count = field.size if field.array is Array.FIXED else random.integers(
            0, min(field.size or 4, 4), endpoint=True)
        return [value(field) for _ in range(count)]

    return {field.name: values(field) for field in definition.types[name].fields
            if field.name != PLACEHOLDER}
