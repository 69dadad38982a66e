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

"""Saving of a calibration and its undo, with prepared answers of a node."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from opencv_tools.viewer.calibrate.session import Result
from opencv_tools.viewer.calibrate.sessions import Former, NodeCamera
from opencv_tools.viewer.errors import NoAnswerError, RequestError
from opencv_tools.viewer.graph import GraphState
from opencv_tools.viewer.hub import Hub
from sensor_msgs.msg import CameraInfo

SAVED = {'service': '/set_camera_info', 'message': ''}
RESULT = cast('Result', SimpleNamespace(calibration=SimpleNamespace(
    size=(64, 48), model='plumb_bob', d=np.zeros(5), k=np.eye(3), p=np.eye(3, 4))))


class PreparedHub:
    """A hub whose nodes give prepared answers, one after the other."""

    def __init__(self, *answers: Former | dict[str, Any] | RequestError) -> None:
        self.answers = [*answers]

    async def refresh(self) -> GraphState:
        return GraphState()

    async def control(self, _choose: object) -> dict[str, Any]:
        answer = self.answers.pop(0)
        if isinstance(answer, RequestError):
            raise answer
        return {'former': answer} if isinstance(answer, Former) else answer


def run(action: Coroutine[Any, Any, str]) -> str:
    """Return what an action says, or why it was refused."""
    try:
        return asyncio.run(action)
    except RequestError as err:
        return str(err)


def test_failed_saving_has_no_undo() -> None:
    hub = PreparedHub(Former(CameraInfo()), RequestError('no'))
    camera = NodeCamera(cast('Hub', hub), '/image')
    assert run(camera.save(RESULT)) == 'no'
    assert not camera.can_restore
    assert run(camera.restore()).startswith('there is no former calibration: it was not saved')
    assert hub.answers == []


def test_saving_without_an_answer_has_an_undo() -> None:
    hub = PreparedHub(Former(CameraInfo()), NoAnswerError('no answer'), SAVED)
    camera = NodeCamera(cast('Hub', hub), '/image')
    assert run(camera.save(RESULT)).startswith('no answer: the calibration may be saved later')
    assert camera.can_restore
    assert run(camera.restore()) == 'the former calibration is back: /set_camera_info'
    assert not camera.can_restore and hub.answers == []


def test_undo_of_several_savings() -> None:
    hub = PreparedHub(
        Former(CameraInfo()), SAVED, RequestError('no'), SAVED, RequestError('no'), SAVED)
    camera = NodeCamera(cast('Hub', hub), '/image')
    assert run(camera.save(RESULT)) == 'saved: /set_camera_info'
    assert run(camera.save(RESULT)) == 'no'
    assert run(camera.save(RESULT)) == 'saved: /set_camera_info'  # the former one is not read
    assert run(camera.restore()) == 'no'
    assert camera.can_restore
    assert run(camera.restore()) == 'the former calibration is back: /set_camera_info'
    assert not camera.can_restore and hub.answers == []


def test_camera_without_a_former_calibration() -> None:
    hub = PreparedHub(Former(None, 'there was no calibration before'), SAVED, SAVED)
    camera = NodeCamera(cast('Hub', hub), '/image')
    for _ in range(2):
        assert run(camera.save(RESULT)) == (
            'saved: /set_camera_info; it has no undo: there was no calibration before')
        assert not camera.can_restore
    assert run(camera.restore()) == (
        'there is no former calibration: there was no calibration before')
    assert hub.answers == []
