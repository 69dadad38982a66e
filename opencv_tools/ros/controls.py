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

"""The settings of a camera as parameters of a node."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

from opencv_tools.capture.controls import Control, ControlType
from opencv_tools.capture.frame import CaptureError
from opencv_tools.capture.v4l2 import CameraSource
from opencv_tools.ros.parameters import (
    closest_name, declare_parameter, describe_unknown, Parameter, ParameterError,
    unknown_parameters,
)
from opencv_tools.ros.timers import create_steady_timer
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
import rclpy.parameter
from rclpy.timer import Timer

# Of a setting that is called like a parameter of the node.
_SUFFIX = '_control'

# How soon a parameter shows what another program has changed.
_FOLLOW_SECONDS = 1.0


class CameraControls:
    """
    Declare a parameter for each setting that a camera has, and set the camera by them.

    What was set by a parameter is set again on a camera that comes back, as it was last, whichever
    program set it last. A parameter shows what the camera has.
    """

    def __init__(self, node: Node, table: Sequence[Parameter],
                 camera: Callable[[], CameraSource | None]) -> None:
        """
        Wait for a camera.

        :param node: has the parameters.
        :param table: those it has anyhow; what was given beside them is for the camera.
        :param camera: gives the camera as long as it is there.
        """
        self._node = node
        self._table = table
        self._camera = camera
        self._controls: dict[str, tuple[Parameter, Control]] = {}
        self._given = unknown_parameters(node, table)
        self.wanted = tuple((name.removesuffix(_SUFFIX), int(value))
                            for name, value in self._given.items() if isinstance(value, int))
        self._showing = False
        self._timer: Timer | None = None
        node.add_on_set_parameters_callback(self._set)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the camera that was opened last, and of those before."""
        return tuple(parameter for parameter, _ in self._controls.values())

    def declare(self, camera: CameraSource) -> None:
        """
        Declare the parameters of a camera that was opened; those that it had before stay.

        :param camera: the camera.
        """
        try:
            controls = camera.controls()
        except CaptureError:
            return  # it has gone again
        for control, value in controls.items():
            parameter = self._parameter(control, value)
            if parameter.name not in self._controls:
                self._declare(parameter, control)
        self._show(controls)
        self._timer = self._timer or create_steady_timer(
            self._node, _FOLLOW_SECONDS, self._follow)
        self.refuse_the_rest()

    def refuse_the_rest(self) -> None:
        """Log, once, which of the parameters that were given nobody has."""
        given, self._given = self._given, {}
        for name in sorted(given.keys() - self._controls.keys()):
            self._node.get_logger().warning(
                describe_unknown(name, [*self._table, *self.parameters]))

    def report_unused(self) -> None:
        """Log, once and from any thread, what is not used as long as there is no camera."""
        given, self._given = self._given, {}
        for name in sorted(given):
            meant = closest_name(name, [parameter.name for parameter in self._table])
            hint = f' (did you mean {meant}?)' if meant else ''
            self._node.get_logger().warning(
                f'not used so far: {name}{hint}; it is no parameter of the node, and there is no '
                'camera whose setting it could be')

    def _follow(self) -> None:
        """Show what the camera, or another program, has changed, and keep what was set."""
        camera = self._camera()
        if camera is None:
            return
        with suppress(CaptureError):  # it has gone, and comes back with what was wanted
            changed = camera.controls(changed=True)
            wanted = dict(self.wanted)
            kept = {control.name: value for control, value in changed.items() if control.active
                    and control.name in wanted and self._shown(control) not in (None, value)}
            self._show(changed)
            self.wanted = tuple({**wanted, **kept}.items())

    def _shown(self, control: Control) -> int | None:
        """Read what the parameter of a setting shows, if it has one."""
        name = self._name(control)
        return int(self._node.get_parameter(name).value) if name in self._controls else None

    def _show(self, values: Mapping[Control, int]) -> None:
        """Change the parameters of settings to what the camera has, without setting it."""
        for control, value in values.items():
            if self._shown(control) in (None, value):
                continue
            name = self._name(control)
            kind = type(self._controls[name][0].default)
            self._showing = True
            (result,) = self._node.set_parameters(
                [rclpy.parameter.Parameter(name, value=kind(value))])
            self._showing = False
            if not result.successful:
                self._node.get_logger().warning(f'{name} is {value} now: {result.reason}')

    def _declare(self, parameter: Parameter, control: Control) -> None:
        try:
            declare_parameter(self._node, parameter)
        except ParameterError as err:
            self._node.get_logger().warning(str(err))
            self._node.undeclare_parameter(parameter.name)
            declare_parameter(self._node, parameter)
        self._controls[parameter.name] = parameter, control

    def _name(self, control: Control) -> str:
        """Name the parameter of a setting."""
        taken = any(parameter.name == control.name for parameter in self._table)
        return control.name + _SUFFIX if taken else control.name

    def _parameter(self, control: Control, value: int) -> Parameter:
        """Describe a setting whose value is known."""
        name = self._name(control)
        menu = ', '.join(f'{number} {text}' for number, text in control.choices)
        description = (f'setting of the camera, {control.default} unless set'
                       + (f': {menu}' if menu else ''))
        if control.kind == ControlType.BOOLEAN:
            return Parameter(name, bool(value), description)
        if control.choices:
            return Parameter(name, value, description,
                             choices=tuple(number for number, _ in control.choices))
        # Some drivers have values that their own ranges do not, or no step.
        step = max(1, control.step)
        even = (value - control.minimum) % step == 0
        return Parameter(name, value, description, min(value, control.minimum),
                         max(value, control.maximum), step=step if even else 1)

    def _set(self, changes: list[rclpy.parameter.Parameter]) -> SetParametersResult:
        """Set the camera to all that was changed, or to nothing of it, with the reason."""
        if self._showing:
            return SetParametersResult(successful=True)
        camera = self._camera()
        before: list[tuple[Control, int]] = []
        wanted = dict(self.wanted)
        try:
            for parameter, control, value in self._accept(changes):
                if camera:
                    camera.set_control(control, value)
                    before.append((control, int(self._node.get_parameter(parameter.name).value)))
                wanted[control.name] = value
        except (CaptureError, ParameterError) as err:
            for control, value in before:
                with suppress(CaptureError):
                    camera.set_control(control, value)
            return SetParametersResult(successful=False, reason=str(err))
        self.wanted = tuple(wanted.items())
        return SetParametersResult(successful=True)

    def _accept(
        self, changes: list[rclpy.parameter.Parameter],
    ) -> list[tuple[Parameter, Control, int]]:
        """
        Pick the changes of the camera's settings.

        :raises ParameterError: a value that the camera cannot have.
        """
        known = [(*self._controls[change.name], change.value) for change in changes
                 if change.name in self._controls]
        return [(parameter, control, int(parameter.accept(value)))
                for parameter, control, value in known]
