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

"""Check of the annotations of a module, which are read only by tools such as Sphinx and IDEs."""

from __future__ import annotations

from collections.abc import Iterator
import inspect
from types import ModuleType
from typing import Any, get_type_hints


def resolved_hints(module: ModuleType) -> dict[str, dict[str, Any]]:
    """
    Return the types of all classes, functions and methods that a module defines, by their names.

    :raises NameError: an annotation has a name that does not exist at run time.
    :raises TypeError: an annotation is not a type.
    """
    return {owner.__qualname__: get_type_hints(owner) for owner in _annotated(module)}


def _annotated(module: ModuleType) -> Iterator[Any]:
    for value in vars(module).values():
        if getattr(value, '__module__', '') != module.__name__:
            continue
        if inspect.isfunction(value):
            yield value
        elif inspect.isclass(value):
            yield value
            for member in vars(value).values():
                function = member.fget if isinstance(member, property) else member
                if inspect.isfunction(function) and function.__module__ == module.__name__:
                    yield function
