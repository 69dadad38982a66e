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
Table of all controls of the pages: what each of them acts on, and the test of it.

Two of the thing exist in the test, and the other one does not change. A control that is added to a
page needs a row.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
import re

from opencv_tools.viewer.calibrate.live import _ACTIONS
from opencv_tools.viewer.web.page_socket import _CONTROLS
import pytest

ROOT = Path(__file__).parents[3]
VIEWER, ROBOT = (ROOT / 'opencv_tools' / folder / 'page' for folder in ('viewer', 'robot/view'))
#: It changes only what this browser shows, of the page as a whole.
PAGE = ''
TILE = 'browser/test_page_buttons.py::test_tile_beside_another_one'
ORDER = 'browser/test_page_buttons.py::test_one_of_three_tiles'
TURNED = 'browser/test_page_buttons.py::test_turned_picture_that_is_saved'
ORIGIN = 'browser/test_page_look.py::test_origin_of_a_picture'
PLACES = 'browser/test_page_look.py::test_places_of_extremes_and_over_exposed_pixels'
CHOSEN = 'browser/test_page_record.py::test_chosen_topics_and_download'
FILE = 'browser/test_page_buttons.py::test_picture_that_is_saved'
STEP = 'nodes/test_viewer_http.py::test_file_of_the_displayed_picture'
CAMERA = 'nodes/test_viewer_control.py::test_one_of_two_cameras'
RECORDER = 'nodes/test_viewer_control.py::test_saved_frame'
STOP = 'nodes/test_viewer_recording.py::test_stop_of_another_recording_is_refused'
KEPT = 'nodes/test_viewer_recording.py::test_last_seconds_of_two_topics'
RANGE = 'browser/test_page_look.py::test_range_of_a_topic_that_was_left'
BOTH = 'browser/test_page_overlays.py::test_two_pages_and_the_topic_beside'  # as documented
RECTIFIED = 'browser/test_page_rectified.py::test_no_switch'
SESSION = 'nodes/test_viewer_calibration.py::test_session_of_another_topic_does_not_change'
RESULT = 'nodes/test_viewer_calibration.py::test_whole_calibration'
VIEW = 'unit/viewer/test_calibration_session.py::test_deleted_views'
SERVICE = 'unit/viewer/test_control.py::test_service_of_two_nodes_is_refused'

CONTROLS = {
    VIEWER / 'index.html': {
        **dict.fromkeys(('back', 'previous', 'next', 'search', 'size', 'beside', 'pause', 'full',
                         'show-robot', 'link', 'plain-link', 'unhide'), PAGE),
        'earlier': STEP, 'later': STEP, 'save': FILE, 'save-turned': TURNED, 'record': STOP,
        'keep': KEPT, 'bag': CHOSEN, 'record-chosen': CHOSEN,
        **dict.fromkeys(('choose', 'forget', 'fold', 'help', 'graph-link'), PAGE),
        'rectified': RECTIFIED, 'calibrate': SESSION,
        **dict.fromkeys(('automatic', 'low', 'high', 'colors'), RANGE),
        **dict.fromkeys(('boxes', 'center', 'outline', 'grid', 'cross', 'look overlays'), BOTH),
        **dict.fromkeys(('look out', 'look in', 'look fit', 'look one', 'look turn', 'look flip',
                         'look profile', 'look histogram', 'look exposed'), TILE),
        'look copy': ORIGIN,
        **dict.fromkeys(('arrange pin', 'arrange earlier', 'arrange later', 'arrange hide'),
                        ORDER)},
    VIEWER / 'graph.html': dict.fromkeys(('back', 'search'), PAGE),
    VIEWER / 'calibrate.html': {
        **dict.fromkeys(('back', 'coverage', 'pdf', 'svg', 'model'), PAGE),
        **dict.fromkeys(('board-text', 'submit', 'take', 'resume', 'discard', 'solve', 'restore'),
                        SESSION),
        'undo': VIEW, 'save': RESULT, 'file': RESULT},
    # This page has no topic and no camera. Nothing that it does reaches another node.
    ROBOT / 'index.html': dict.fromkeys((
        'back', 'resume', 'fit', 'zero', 'save', 'view-urdf', 'view-sdf', 'view-both',
        'show-visuals', 'show-collisions', 'show-inertia', 'show-frames', 'show-names',
        'show-axes', 'fade', 'file'), PAGE)}

#: Buttons that scripts create, in their order.
CREATED = {'settings.js': [CAMERA, RECORDER],  # Start camera and Stop camera; recorders
           'calibrate_panel.js': [VIEW], 'chart.js': [PLACES],
           'panel.js': [PAGE, PAGE, PAGE]}

#: Words of the messages that act on other nodes or on the disk.
WORDS = {'parameters': CAMERA, 'set': CAMERA, 'capture': CAMERA, 'save': RECORDER, 'keep': KEPT,
         'record': STOP}
ACTIONS = {'board': SESSION, 'delete': VIEW, 'take': SESSION, 'discard': SESSION,
           'resume': SESSION, 'solve': SESSION, 'save': RESULT, 'restore': SESSION}


def controls_of(text: str) -> set[str]:
    """Return the names of the controls of a page."""
    found = set()
    for tag, attributes in re.findall(r'<(button|a|input|select|textarea)\b([^>]*)>', text):
        values = dict(re.findall(r'([\w-]+)="([^"]*)"', attributes))
        if tag != 'a' or 'id' in values:  # a link without a name is that of a tile
            kind = next((one for one in ('look', 'arrange') if f'data-{one}' in values), '')
            found.add(f'{kind} {values[f"data-{kind}"]}' if kind
                      else values.get('id') or values.get('name') or values['type'])
    return found


@pytest.mark.parametrize('page', CONTROLS, ids=lambda page: page.name)
def test_each_control_has_a_row(page: Path) -> None:
    assert controls_of(page.read_text()) == set(CONTROLS[page])


def test_control_without_a_row_is_found() -> None:
    assert controls_of('<button type="button" data-look="in" title="a">+</button>'
                       '<a class="frame"></a><a id="file" href="/"><input name="grid">') == {
        'look in', 'file', 'grid'}


def test_each_created_button_has_a_row() -> None:
    counts = Counter({path.name: len(re.findall(r"\b(?:make|element|createElement)\('button'",
                                                path.read_text()))
                      for path in (*VIEWER.glob('*.js'), *ROBOT.glob('*.js'))
                      if path.name != 'three.js'})
    assert +counts == {name: len(rows) for name, rows in CREATED.items()}


def test_each_message_has_a_row() -> None:
    assert (set(_CONTROLS), set(_ACTIONS)) == (set(WORDS), set(ACTIONS))


def test_each_row_has_a_test() -> None:
    rows = {test for table in (*CONTROLS.values(), WORDS, ACTIONS) for test in table.values()}
    for test in rows.union(*CREATED.values()) - {PAGE} | {SERVICE}:
        path, _, name = test.partition('::')
        assert f'\ndef {name}(' in (ROOT / 'test' / path).read_text(), test
