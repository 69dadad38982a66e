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

"""The class of a message type for rclpy: the compiled one, or one made from its definition."""

from __future__ import annotations

from contextlib import suppress
import hashlib
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from threading import Lock
from typing import Any

from opencv_tools.message_types.definition import DefinitionError, full_name, read_definition
from opencv_tools.transport.type_support import hash_of, TypeSupport

_MAX_TYPES = 1000  # that are made in a process; they remain until it ends
_made: dict[str, type] = {}
# The class, or the error, of each name and digest of a text, because a text may take a second.
_results: dict[tuple[str, bytes], type | str] = {}
_lock = Lock()


def message_type(name: str, text: str | None = None) -> type:
    """
    Return the class of a message type for ``create_publisher`` and ``create_subscription``.

    A class that is not compiled has no messages: publish bytes of CDR, and subscribe with
    ``raw=True``. It works with Fast DDS.

    :param name: name of the type, ``package/msg/Name``.
    :param text: its definition, as for `read_definition`; None for the compiled one or that of
        this package.
    :returns: the compiled class, if there is one with this definition; else one that is made.
    :raises DefinitionError: the definition is unknown or invalid, or the type is in use with
        another definition.
    """
    name = full_name(name)
    if text is None:
        return _import(name) or _make(name, None)
    key = name, hashlib.sha256(text.encode(errors='surrogatepass')).digest()
    result = _results.get(key)
    if result is None:
        try:
            result = _make(name, text)
        except DefinitionError as err:
            result = str(err)
        with _lock:
            _results[key] = result
            if len(_results) > _MAX_TYPES:
                del _results[next(iter(_results))]
    if isinstance(result, str):
        raise DefinitionError(result)
    return result


def _make(name: str, text: str | None) -> type:
    """Return the compiled class if it has the definition, else one that is made from it."""
    made = TypeSupport(read_definition(name, text))
    compiled: Any = _import(name)
    if compiled and hash_of(compiled) == made.type_hash:
        return compiled
    with _lock:
        known = _made.get(name)
        if known is None:
            if len(_made) >= _MAX_TYPES:
                raise DefinitionError(f'{name} is not made: {_MAX_TYPES} types are, which is the '
                                      'limit')
            known = _made[name] = made.python_class()
    if hash_of(known) != made.type_hash:
        raise DefinitionError(f'{name} is in use with another definition')
    return known


def _import(name: str) -> Any:
    """Return the compiled class of a type, or None; no other module than its own is imported."""
    package, _, short = name.split('/')
    # A package may have services only, or be broken.
    with suppress(ImportError, ValueError):
        found = find_spec(package)
        for folder in (found and found.submodule_search_locations) or ():
            if any(Path(folder).glob(f'{package}_s__rosidl_typesupport_c*')):
                compiled: Any = getattr(import_module(f'{package}.msg'), short, None)
                if compiled and type(compiled)._TYPE_SUPPORT is None:
                    type(compiled).__import_type_support__()
                return compiled
    return None
