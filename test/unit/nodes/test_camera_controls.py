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


"""Camera controls as parameters, with a simulated camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from conftest import spin_until
from opencv_tools.capture.errors import UnavailableError
from opencv_tools.capture.v4l2.controls import Control, ControlType
from opencv_tools.nodes.declaration import declare_parameters, watch_parameters
from opencv_tools.nodes.parameters import Parameter
from opencv_tools.nodes.publisher.camera_controls import CameraControls
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

TABLE = (Parameter('source', '0', 'a source'),
         Parameter('gain', 1.0, 'a number of the node', bounds=(0, 9), changeable=True))
BRIGHTNESS = Control(name='brightness', number=1, kind=ControlType.INTEGER, minimum=0, maximum=255,
                     step=1, default=128)
FLIP = Control(name='flip', number=2, kind=ControlType.BOOLEAN, minimum=0, maximum=1, step=1,
               default=0)
GAIN = Control(name='gain', number=3, kind=ControlType.INTEGER, minimum=0, maximum=10, step=1,
               default=5)


class Camera:
    """A camera that keeps its values and records the calls."""

    def __init__(self) -> None:
        self.values = {BRIGHTNESS: 128, FLIP: 0, GAIN: 5}
        self.changed: dict[Control, int] = {}
        self.calls: list[tuple[str, int]] = []
        self.is_disconnected = False

    def controls(self, changed: bool = False) -> dict[Control, int]:
        if self.is_disconnected:
            raise UnavailableError('disconnected')
        found, self.changed = (self.changed if changed else dict(self.values)), {}
        return found

    def set_control(self, control: Control, value: int) -> None:
        if control == FLIP and self.values[BRIGHTNESS] == 13:
            raise UnavailableError('camera refuses flip')
        self.calls.append((control.name, value))
        self.values[control] = value

    def change(self, control: Control, value: int) -> None:
        """Change a control like another program."""
        self.values[control] = self.changed[control] = value


class Controlled(Node):
    """A node with a camera."""

    def __init__(self, context: Context) -> None:
        super().__init__('controlled', context=context,
                         automatically_declare_parameters_from_overrides=True)
        declare_parameters(self, TABLE)
        self.camera: Camera | None = Camera()
        self.controls = CameraControls(self, TABLE, lambda: self.camera)
        watch_parameters(self, TABLE, lambda _: None, lambda: self.controls.parameters)

    def change(self, **values: object) -> str:
        result = self.set_parameters_atomically(
            [rclpy.Parameter(name, value=value) for name, value in values.items()])
        return '' if result.successful else result.reason

    def values(self) -> tuple[int, bool, int]:
        return tuple(self.get_parameter(name).value
                     for name in ('brightness', 'flip', 'gain_control'))


@pytest.fixture
def controlled(domain: int) -> Iterator[Callable[..., Controlled]]:
    """Return a function that creates a node with given parameters."""
    context = Context()
    nodes = []

    def _make(*assignments: str) -> Controlled:
        words = [word for assignment in assignments for word in ('-p', assignment)]
        rclpy.init(context=context, domain_id=domain, args=['--ros-args', *words])
        nodes.append(Controlled(context))
        return nodes[-1]

    yield _make
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown(context=context)


def test_values_from_parameters(controlled: Callable[..., Controlled]) -> None:
    node = controlled('brightness:=100')
    assert node.controls.requested == (('brightness', 100),)
    node.camera.values[BRIGHTNESS] = 100
    node.controls.declare()
    assert node.values() == (100, False, 5)
    assert node.change(flip=1, gain_control=7, gain=3) == ''
    assert node.values() == (100, True, 7)
    assert node.get_parameter('gain').value == 3.0
    assert node.camera.calls == [('flip', 1), ('gain', 7)]
    assert dict(node.controls.requested) == {'brightness': 100, 'flip': 1, 'gain': 7}
    assert 'out of range' in node.change(brightness=256)
    assert 'Wrong parameter type' in node.change(brightness=5.5)
    assert 'camera refuses flip' in node.change(brightness=13, flip=False)
    assert node.camera.values[BRIGHTNESS] == 100
    assert node.values() == (100, True, 7)


def test_values_from_another_program(
        controlled: Callable[..., Controlled]) -> None:
    node = controlled('flip:=true', 'brightness:=50')
    node.controls.declare()
    node.camera.change(BRIGHTNESS, 77)
    node.camera.change(replace(GAIN, active=False), 9)  # automatic: the camera chooses the value
    spin_until(node, lambda: node.values() == (77, False, 9))
    assert node.camera.calls == []
    assert dict(node.controls.requested) == {'flip': 1, 'brightness': 77}
    node.camera.change(BRIGHTNESS, 999)  # outside the reported range
    node.camera.change(FLIP, 1)
    spin_until(node, lambda: node.values() == (77, True, 9))
    node.camera.is_disconnected = True
    disconnected, node.camera = node.camera, Camera()
    node.camera.values = {BRIGHTNESS: 77, FLIP: 1, GAIN: 4}
    node.controls.declare()
    assert node.values() == (77, True, 4)
    assert node.camera.calls == disconnected.calls == []


def test_one_warning_about_unknown_parameters(
        controlled: Callable[..., Controlled], capfd: pytest.CaptureFixture[str]) -> None:
    node = controlled('sorce:=1', 'contrast:=3', 'brightness:=5')
    for _ in range(2):
        node.controls.declare()
        node.controls.report_unused()
    output = capfd.readouterr().err
    assert output.count('unknown parameter sorce is not used; did you mean source?') == 1
    assert output.count(
        'unknown parameter contrast is not used; the parameters are source, gain, ') == 1
    assert 'brightness is' not in output
    assert len(output.splitlines()) == 2


def test_one_warning_before_the_camera_is_open(
        controlled: Callable[..., Controlled], capfd: pytest.CaptureFixture[str]) -> None:
    node = controlled('sorce:=1', 'contrast:=3', 'brightness:=5')
    for _ in range(2):
        node.controls.report_unused()
        node.controls.declare()
        node.controls.report_unused()
    output = capfd.readouterr().err
    assert output.count('sorce is not used yet (did you mean source?); it is not a ') == 1
    assert output.count(' is not used yet') == 3
    assert len(output.splitlines()) == 3
