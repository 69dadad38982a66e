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

"""Shapes of the messages of the pages, and what the server knows of them."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
import re
from typing import Any

from opencv_tools.viewer import protocol
from opencv_tools.viewer.calibrate.live import _ACTIONS
from opencv_tools.viewer.inspect.looks import _ANSWERS
from opencv_tools.viewer.protocol import ViewRequest
from opencv_tools.viewer.web.page_socket import _CONTROLS
from page_messages import problems, shapes
import pytest

PAGE = Path(protocol.__file__).parent / 'page'


@pytest.mark.parametrize(('value', 'kind', 'found'), [
    ({'pong': 1, 'now': 2.5}, 'Answer', []),
    ({'more': True}, 'Answer', ['.more: True is not number']),
    ({'refused': {'topic': '/a'}}, 'Answer', ['.refused.reason is missing']),
    ({'new': 1}, 'Answer', ['.new is not in Answer']),
    ([[1, None]], '(number | null)[][]', []),
    ([1, 'a'], '[number, string]', []),
    ([1], '[number, string]', [': [1] is no list of 2']),
    ({'hello': {}}, 'RobotAnswer', []),
    ({'left': 'a'}, 'Record<string, number>', [".left: 'a' is not number"]),
], ids=str)
def test_values_and_types(value: Any, kind: str, found: list[str]) -> None:
    assert problems(value, kind) == found


def test_options_of_a_subscription() -> None:
    # limits is range in a message; slow is of the link, and fixed of the page.
    names = {field.name for field in fields(ViewRequest)} - {'limits', 'slow'}
    assert names | {'subscribe', 'range'} == set(shapes()['Subscribe'])


def test_words_of_requests() -> None:
    assert {*_CONTROLS, *_ANSWERS} <= set(shapes()['Request'])
    assert set(shapes()['SessionRequest']) == {*_ACTIONS, 'ping'}


def test_places_in_binary_messages() -> None:
    head, video = protocol._HEAD.size, protocol._VIDEO_HEAD.size
    found = dict(re.findall(r'(\w+): (\d+)', re.search(
        r'^const HEAD = \{(.*)\};', (PAGE / 'video.js').read_text(), re.MULTILINE)[1]))
    assert found == {'key': str(head), 'name': str(head + 1), 'width': str(head + 2),
                     'height': str(head + 4), 'number': str(head + 6), 'end': str(head + video)}
    tile = (PAGE / 'tile.js').read_text()
    assert f'const PLACE = {head};' in tile
    assert f'const HEAD_BYTES = {head + protocol._PLACE.size};' in tile
