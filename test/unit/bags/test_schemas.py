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

"""Schemas in bags, compared with the types that a reader finds without them."""

from __future__ import annotations

from opencv_tools.bags.schemas import MESSAGE_DEFINITIONS
from opencv_tools.message_types.definition import read_definition
import pytest


@pytest.mark.parametrize('type_name', MESSAGE_DEFINITIONS)
def test_schema_has_all_types(type_name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = read_definition(type_name)
    monkeypatch.setattr('opencv_tools.message_types.definition._known_text', {}.__getitem__)
    found = read_definition(type_name, MESSAGE_DEFINITIONS[type_name])
    assert {name: each.fields for name, each in found.types.items()} == {
        name: each.fields for name, each in expected.types.items()}
