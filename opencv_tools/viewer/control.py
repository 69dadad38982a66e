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

"""Control of cameras and recorders: parameters as JSON, pauses and saved frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import re
import time
from typing import Any

from opencv_tools.base.text import enumerated, MAX_PATH, printable
from opencv_tools.topics.timers import create_steady_timer
from opencv_tools.viewer.errors import MAX_MESSAGE, NoAnswerError, RequestError
from opencv_tools.viewer.protocol import finite
from opencv_tools.viewer.recording.page_recorder import PageRecorder
from rcl_interfaces.msg import Parameter, ParameterDescriptor, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

# Type, field of ParameterValue and type in Python, by the number of the type.
_TYPES: dict[int, tuple[str, str, type]] = {
    ParameterType.PARAMETER_BOOL: ('bool', 'bool_value', bool),
    ParameterType.PARAMETER_INTEGER: ('integer', 'integer_value', int),
    ParameterType.PARAMETER_DOUBLE: ('double', 'double_value', float),
    ParameterType.PARAMETER_STRING: ('string', 'string_value', str),
}
_CHOICES = 'one of: '
# An item of a menu in the description of a camera control: '1 50 Hz'.
_MENU_ITEM = r'(?:: |, ){} ([^,]*)'


def parameter_json(
    descriptor: ParameterDescriptor, value: ParameterValue,
) -> dict[str, Any] | None:
    """
    Return a parameter of the protocol; None for a list or an unset parameter.

    :param descriptor: name, range and description.
    """
    if value.type not in _TYPES:
        return None
    kind, _, _ = _TYPES[value.type]
    shown = value_json(value)
    is_changed = kind == 'string' and shown != value.string_value
    ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
    low, high, step = ((finite(ranges[0].from_value), finite(ranges[0].to_value),
                        finite(ranges[0].step)) if ranges else (None, None, None))
    return {
        'name': printable(descriptor.name), 'type': kind,
        'value': shown, 'minimum': low, 'maximum': high, 'step': step or None,
        'choices': _choices(descriptor, kind),
        'description': printable(descriptor.description, MAX_MESSAGE),
        'read_only': descriptor.read_only or is_changed}


def value_json(value: ParameterValue) -> Any:
    """
    Return a value for JSON; a long text is cut.

    :raises RequestError: the value has a type that is not shown.
    """
    _, field, _ = _type_of(value)
    found = getattr(value, field)
    if isinstance(found, str):
        return printable(found, MAX_MESSAGE)
    return finite(found) if isinstance(found, float) else found


def value_from_json(given: Any, present: ParameterValue) -> ParameterValue:
    """
    Return a value of JSON with the type of the present value.

    :raises RequestError: the value has another type.
    """
    kind, field, python_type = _type_of(present)
    if python_type is float and type(given) is int:
        given = float(given) if abs(given) < 2**53 else given
    if type(given) is not python_type or (
            isinstance(given, int) and not -2**63 <= given < 2**63):
        raise RequestError(f'{str(given)[:40]!r} is not a value of the type {kind}')
    if isinstance(given, str):
        given = encodable(given)
    return ParameterValue(type=present.type, **{field: given})


def encodable(text: str) -> str:
    """Return a text that a message of ROS can hold."""
    return text.encode(errors='replace').decode().replace('\0', '')


def _type_of(value: ParameterValue) -> tuple[str, str, type]:
    """Return the row of ``_TYPES`` of a value."""
    if value.type not in _TYPES:
        raise RequestError('the parameter is not a number, a text or true or false')
    return _TYPES[value.type]


def _choices(descriptor: ParameterDescriptor, kind: str) -> list[tuple[Any, str]]:
    """Return the valid values with their names, as the nodes of this package describe them."""
    constraint = descriptor.additional_constraints
    if not constraint.startswith(_CHOICES) or kind not in ('integer', 'string'):
        return []
    choices: list[tuple[Any, str]] = []
    for text in constraint.removeprefix(_CHOICES)[:MAX_MESSAGE].split(', '):
        if kind == 'string':
            choices.append((text, printable(text)))
        elif re.fullmatch('-?[0-9]{1,18}', text):
            item = re.search(_MENU_ITEM.format(re.escape(text)), descriptor.description)
            choices.append((int(text), printable(item[1]) if item else text))
    return choices


_SECONDS = 5.0
_RETRY_SECONDS = 0.05
# An answer is lost if its server does not know the client yet, so a new client waits.
_DISCOVERY_SECONDS = 0.3
_PAUSE_SECONDS = 1.0  # until the service of a new camera is discovered
_MAX_CLIENTS = 64
_MAX_PARAMETERS = 500
_MAX_NODES = 50
_MAX_SERVERS = 500  # nodes that are asked for the servers of a service
_SAVE, _CAPTURE = '/save', '/set_capture'
_TRIGGER, _SET_BOOL = 'std_srvs/srv/Trigger', 'std_srvs/srv/SetBool'
_READING: dict[type, str] = {
    ListParameters: 'list_parameters', DescribeParameters: 'describe_parameters',
    GetParameters: 'get_parameters'}
_HIDDEN = ('qos_overrides.', 'start_type_description_service', 'use_sim_time')


class CameraControl:
    """
    Call services of cameras and recorders; all methods run in the executor.

    Only nodes that publish images, or that have ``~/save``, are called.
    """

    def __init__(self, node: Node, recorder: PageRecorder | None = None) -> None:
        """
        Create an object without clients.

        :param recorder: recorder of this node, if it has a folder.
        """
        #: Node of the clients.
        self.node = node
        self.recorder = recorder
        self._group = ReentrantCallbackGroup()
        self._clients: dict[str, tuple[Client, float]] = {}
        self._cameras: dict[str, bool] = {}
        self._recorders: list[str] = []

    def nodes(self, publishing: Iterable[str]) -> dict[str, list[str]]:
        """
        Return the nodes that can be controlled.

        :param publishing: names of the nodes that publish images.
        """
        services = dict(self.node.get_service_names_and_types())
        self._recorders = sorted(
            name for name in {*node_names(self.node)}
            if _TRIGGER in services.get(name + _SAVE, ()))[:_MAX_NODES]
        self._cameras = {
            name: _has_pause(name, services)
            for name in sorted(set(publishing))[:_MAX_NODES]
            if f'{name}/describe_parameters' in services}
        return {'cameras': list(self._cameras), 'recorders': self._recorders}

    async def parameters(self, camera: Any) -> dict[str, Any]:
        """Return the parameters of a camera."""
        self._check(camera, self._cameras)
        for service_type, name in _READING.items():  # together, because each needs discovery
            self._client(service_type, f'{camera}/{name}')
        names = (await self.call(ListParameters, f'{camera}/list_parameters',
                                 ListParameters.Request())).result.names
        names = [name for name in names if not name.startswith(_HIDDEN)][:_MAX_PARAMETERS]
        described = await self.call(DescribeParameters, f'{camera}/describe_parameters',
                                    DescribeParameters.Request(names=names))
        values = await self._values(camera, names)
        found = [parameter_json(descriptor, value)
                 for _, descriptor, value in zip(names, described.descriptors, values)]
        # The service may have been discovered after the parameters of its node.
        self._cameras[camera] = self._can_pause(camera)
        return {'parameters': {'node': camera, 'parameters': [item for item in found if item],
                               'capture': self._cameras[camera]}}

    async def set(self, camera: Any, name: Any, value: Any) -> dict[str, Any]:  # noqa: A003
        """Set a parameter of a camera, and return its value."""
        self._check(camera, self._cameras)
        if not isinstance(name, str):
            raise RequestError('the name of the parameter is missing')
        name = encodable(name)
        present = await self._values(camera, [name])
        if not present:
            raise RequestError(f'{camera} has no parameter {printable(name)}')
        changed = Parameter(name=name, value=value_from_json(value, _only(present, camera)))
        result = _only((await self.call(
            SetParameters, f'{camera}/set_parameters',
            SetParameters.Request(parameters=[changed]))).results, camera)
        now = value_json(_only(await self._values(camera, [name]), camera))
        return {'set': {'node': camera, 'name': name, 'value': now,
                        'ok': result.successful, 'message': printable(result.reason)}}

    async def capture(self, camera: Any, is_on: Any) -> dict[str, Any]:
        """Pause or resume a camera, whose service may be discovered a moment after its node."""
        self._check(camera, self._cameras)
        await self.wait(lambda: self._can_pause(camera), time.monotonic() + _PAUSE_SECONDS)
        if not self._can_pause(camera):
            raise RequestError(f'{camera} has no service {camera}{_CAPTURE}: '
                               'it cannot be stopped from here')
        answer = await self.call(
            SetBool, camera + _CAPTURE, SetBool.Request(data=is_on is True))
        return {'capture': {'node': camera, 'ok': answer.success,
                            'message': printable(answer.message)}}

    async def save(self, recorder: Any) -> dict[str, Any]:
        """Save a frame."""
        self._check(recorder, self._recorders)
        answer = await self.call(Trigger, recorder + _SAVE, Trigger.Request())
        return {'save': {'node': recorder, 'ok': answer.success,
                         'message': printable(answer.message, MAX_PATH)}}

    def _can_pause(self, camera: str) -> bool:
        return _has_pause(camera, dict(self.node.get_service_names_and_types()))

    def _check(self, name: Any, known: Iterable[str]) -> None:
        if not isinstance(name, str) or name not in known:
            raise RequestError(f'{printable(name)} cannot be controlled')

    async def _values(self, camera: str, names: list[str]) -> list[Any]:
        answer = await self.call(
            GetParameters, f'{camera}/get_parameters', GetParameters.Request(names=names))
        return list(answer.values)

    async def call(self, service_type: Any, name: str, request: Any) -> Any:
        """
        Call a service. One that changes something must have one server, which is the node meant.

        :raises RequestError: several nodes have the service.
        :raises NoAnswerError: the service has not answered.
        """
        client, ready_at = self._client(service_type, name)
        deadline = time.monotonic() + _SECONDS
        await self.wait(
            lambda: time.monotonic() >= ready_at and client.service_is_ready(), deadline)
        if service_type not in _READING:
            check_server(self.node, name)
        answer = client.call_async(request)
        await self.wait(answer.done, deadline, answer)
        if not answer.done():
            client.remove_pending_request(answer)
            raise NoAnswerError(f'{printable(name)} has not answered within {_SECONDS:g} s')
        return answer.result()

    async def wait(
        self, condition: Callable[[], bool], deadline: float, future: Future | None = None,
    ) -> None:
        """Wait for a condition, until a deadline; a future that is done ends the wait at once."""
        over = Future(executor=self.node.executor)

        def check(_: object = None) -> None:
            if over.done():
                return
            try:
                if condition() or time.monotonic() >= deadline:
                    over.set_result(None)
            except Exception as err:  # noqa: B902 (a client may have been destroyed meanwhile)
                over.set_exception(err)

        timer = create_steady_timer(self.node, _RETRY_SECONDS, check)
        try:
            check()
            if future:
                future.add_done_callback(check)
            await over
        finally:
            self.node.destroy_timer(timer)

    def _client(self, service_type: Any, name: str) -> tuple[Client, float]:
        """Return a client, and the time from which its server knows it."""
        if name not in self._clients:
            while len(self._clients) >= _MAX_CLIENTS:
                oldest, _ = self._clients.pop(next(iter(self._clients)))
                self.node.destroy_client(oldest)
            client = self.node.create_client(service_type, name, callback_group=self._group)
            self._clients[name] = client, time.monotonic() + _DISCOVERY_SECONDS
        return self._clients[name]


def recorder_of(control: CameraControl) -> PageRecorder:
    """
    Return the recorder of this node.

    :raises RequestError: it has no folder for recordings.
    """
    if control.recorder is None:
        raise RequestError('this node does not record: start it with record_dir:=FOLDER', 403)
    return control.recorder


def _only(answers: Sequence[Any], camera: str) -> Any:
    """
    Return the answer about one parameter.

    :raises RequestError: there is another number of answers.
    """
    if len(answers) != 1:
        raise RequestError(
            f'{camera} has given {len(answers)} answers about one parameter: it may have ended, '
            'or the parameter is gone')
    return answers[0]


def _has_pause(node: str, services: Mapping[str, Sequence[str]]) -> bool:
    """Return whether a node has its service ``~/set_capture``."""
    return _SET_BOOL in services.get(node + _CAPTURE, ())


def node_names(node: Node) -> list[str]:
    """Return the full names of all nodes."""
    return [f'{namespace.rstrip("/")}/{name}'
            for name, namespace in node.get_node_names_and_namespaces()]


def services_of(node: Node, full_name: str) -> dict[str, list[str]]:
    """Return the services of a node with their types."""
    namespace, _, name = full_name.rpartition('/')
    try:
        return dict(node.get_service_names_and_types_by_node(name, namespace or '/'))
    except (NodeNameNonExistentError, ValueError):
        return {}  # it has ended, or its name was not printable


def check_server(node: Node, service: str) -> None:
    """
    Check that a service has one server; all of them would act, and the first answer would count.

    :raises RequestError: it has several.
    """
    count = node.count_services(service)
    if count < 2:
        return
    servers = sorted(printable(name) for name in node_names(node)[:_MAX_SERVERS]
                     if service in services_of(node, name))
    raise RequestError(f'{printable(service)} has {count} servers, in the nodes '
                       f'{enumerated(servers)}: start each with a namespace of its own, such as '
                       '-r __ns:=/front, or end the others')
