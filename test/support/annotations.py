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

"""Annotations that programs evaluate, such as the generator of the documentation."""

from __future__ import annotations

from collections.abc import Iterator
import inspect
from types import ModuleType
from typing import Any, get_type_hints


def check_annotations(module: ModuleType) -> None:
    """Check that the annotations of all classes and functions of a module can be evaluated."""
    checked = list(_annotated(module, module.__name__))
    assert checked
    for item in checked:
        get_type_hints(item)


def _annotated(owner: Any, name: str) -> Iterator[Any]:
    """Yield the classes and functions that a module of this name defines."""
    for member in vars(owner).values():
        item = getattr(member, 'fget', None) or inspect.unwrap(getattr(member, '__func__', member))
        if getattr(item, '__module__', '') == name:
            if inspect.isclass(item):
                yield item
                yield from _annotated(item, name)
            elif inspect.isfunction(item):
                yield item
