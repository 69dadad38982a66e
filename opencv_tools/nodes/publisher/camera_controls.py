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

"""Camera controls as parameters of a node."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

from opencv_tools.base.logs import Log
from opencv_tools.capture.errors import CaptureError
from opencv_tools.capture.v4l2.camera import CameraSource
from opencv_tools.capture.v4l2.controls import Control, ControlType
from opencv_tools.nodes.declaration import (
    closest_name, declare_parameter, describe_unknown, unknown_parameters)
from opencv_tools.nodes.parameters import Parameter
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.timers import create_steady_timer
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
import rclpy.parameter
from rclpy.timer import Timer

# Suffix of a control that has the name of a parameter of the node.
_SUFFIX = '_control'

# Period in which changes by other programs are read from the camera.
_READ_SECONDS = 1.0


class CameraControls:
    """
    Declare a parameter for each control of a camera, and set the controls by parameters.

    Parameters show the values of the camera. After a reconnect, controls that were set by
    parameters get their last values again, even if another program changed them.
    """

    def __init__(self, node: Node, table: Sequence[Parameter],
                 camera: Callable[[], CameraSource | None]) -> None:
        """
        Store the parameters that were given for the camera.

        :param table: parameters of the node itself; other given parameters are for the camera.
        :param camera: returns the camera while it is open, else None.
        """
        self._node = node
        self._log = Log(node.get_logger())
        self._table = table
        self._camera = camera
        self._controls: dict[str, tuple[Parameter, Control]] = {}
        self._unclaimed = unknown_parameters(node, table)
        self.requested = tuple(
            (name.removesuffix(_SUFFIX), int(value))
            for name, value in self._unclaimed.items() if isinstance(value, int))
        self._is_updating = False
        self._timer: Timer | None = None
        self._opened = node.create_guard_condition(self.declare)
        node.add_on_set_parameters_callback(self._set)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the camera that was opened last, and of earlier cameras."""
        return tuple(parameter for parameter, _ in self._controls.values())

    def camera_opened(self) -> None:
        """Call ``declare`` in the executor of the node; thread-safe."""
        self._opened.trigger()

    def declare(self) -> None:
        """Declare the parameters of the open camera; existing parameters stay."""
        camera = self._camera()
        if camera is None:
            return
        try:
            controls = camera.controls()
        except CaptureError:
            return  # it was disconnected again
        for control, value in controls.items():
            parameter = _parameter(self._name(control), control, value)
            if parameter.name not in self._controls:
                self._declare(parameter, control)
        self._update_parameters(controls)
        self._timer = self._timer or create_steady_timer(
            self._node, _READ_SECONDS, self._read_changes)
        self.warn_unknown_parameters()

    def warn_unknown_parameters(self) -> None:
        """Log, once, the given parameters that neither the node nor the camera has."""
        unused, self._unclaimed = self._unclaimed, {}
        for name in sorted(unused.keys() - self._controls.keys()):
            self._log.warning(
                describe_unknown(name, [*self._table, *self.parameters]))

    def report_unused(self) -> None:
        """Log, once, the given parameters that have no effect without a camera; thread-safe."""
        unused, self._unclaimed = self._unclaimed, {}
        for name in sorted(unused):
            similar = closest_name(name, self._table)
            hint = f' (did you mean {similar}?)' if similar else ''
            self._log.warning(
                f'parameter {name} is not used yet{hint}; it is not a parameter of the node, and '
                'no camera is open that may have it')

    def _read_changes(self) -> None:
        """Update the parameters from the camera, and keep changes by other programs."""
        camera = self._camera()
        if camera is None:
            return
        with suppress(CaptureError):  # it was disconnected; a reconnect restores the values
            changed = camera.controls(changed=True)
            requested = dict(self.requested)
            kept = {control.name: value for control, value in changed.items()
                    if control.active and control.name in requested
                    and self._parameter_value(control) not in (None, value)}
            self._update_parameters(changed)
            self.requested = tuple({**requested, **kept}.items())

    def _parameter_value(self, control: Control) -> int | None:
        """Return the value of the parameter of a control; None if it has no parameter."""
        name = self._name(control)
        return int(self._node.get_parameter(name).value) if name in self._controls else None

    def _update_parameters(self, values: Mapping[Control, int]) -> None:
        """Set parameters to the values of the camera, without setting the camera."""
        for control, value in values.items():
            if self._parameter_value(control) in (None, value):
                continue
            name = self._name(control)
            value_type = type(self._controls[name][0].default)
            self._is_updating = True
            (result,) = self._node.set_parameters(
                [rclpy.parameter.Parameter(name, value=value_type(value))])
            self._is_updating = False
            if not result.successful:
                self._log.warning(
                    f'the camera changed {name} to {value}, but the parameter cannot be set: '
                    f'{result.reason}')

    def _declare(self, parameter: Parameter, control: Control) -> None:
        try:
            declare_parameter(self._node, parameter)
        except ParameterError as err:
            self._log.warning(str(err))
            self._node.undeclare_parameter(parameter.name)
            declare_parameter(self._node, parameter)
        self._controls[parameter.name] = parameter, control

    def _name(self, control: Control) -> str:
        """Return the name of the parameter of a control."""
        is_used = any(parameter.name == control.name for parameter in self._table)
        return control.name + _SUFFIX if is_used else control.name

    def _set(self, changes: list[rclpy.parameter.Parameter]) -> SetParametersResult:
        """Set the camera to all changed values, or to none of them with the reason."""
        if self._is_updating:
            return SetParametersResult(successful=True)
        camera = self._camera()
        previous: list[tuple[Control, int]] = []
        requested = dict(self.requested)
        known = [(*self._controls[change.name], change.value) for change in changes
                 if change.name in self._controls]
        try:
            accepted = [(control, int(parameter.accept(value)))
                        for parameter, control, value in known]
            for control, value in accepted:
                if camera:
                    camera.set_control(control, value)
                    name = self._name(control)
                    previous.append((control, int(self._node.get_parameter(name).value)))
                requested[control.name] = value
        except (CaptureError, ParameterError) as err:
            if camera:
                for control, value in previous:
                    with suppress(CaptureError):
                        camera.set_control(control, value)
            return SetParametersResult(successful=False, reason=str(err))
        self.requested = tuple(requested.items())
        return SetParametersResult(successful=True)


def _parameter(name: str, control: Control, value: int) -> Parameter:
    """Return the parameter of a control, given its present value."""
    menu = ', '.join(f'{number} {text}' for number, text in control.choices)
    description = (f'Camera control; the default is {control.default}'
                   + (f': {menu}' if menu else ''))
    if control.kind == ControlType.BOOLEAN:
        return Parameter(name, bool(value), description, changeable=True)
    if control.choices:
        return Parameter(
            name, value, description, choices=tuple(dict(control.choices)), changeable=True)
    # Some drivers report values outside their own range, or a step of 0.
    step = max(1, control.step)
    even = (value - control.minimum) % step == 0
    bounds = min(value, control.minimum), max(value, control.maximum)
    return Parameter(name, value, description, bounds=bounds, step=step if even else 1,
                     changeable=True)
