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

"""Message types without compiled code, in real nodes of several processes."""

from __future__ import annotations

from collections.abc import Callable
import ctypes
import gc
from pathlib import Path
import sys
from typing import Any

from conftest import NodeProcess, spin_until
from installed_messages import (
    compiled_class, installed_texts, installed_type, random_message, SEPARATOR, whole_text)
import numpy as np
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import DefinitionError, read_definition
from opencv_tools.transport import message_type as module, type_support
from opencv_tools.transport.message_type import message_type
from opencv_tools.transport.type_support import hash_of, TypeSupport
import pytest
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage
from type_description_interfaces.srv import GetTypeDescription

Start = Callable[..., NodeProcess]
VIDEO = 'foxglove_msgs/msg/CompressedVideo'

# Made types cannot be beside compiled ones of the same name in one process.
PROGRAM = """
import sys
from pathlib import Path
import rclpy
from opencv_tools.message_types.definition import read_definition
from opencv_tools.transport.type_support import TypeSupport

name, topic, text, data = sys.argv[1], sys.argv[2], Path(sys.argv[3]), bytes.fromhex(sys.argv[4])
made = TypeSupport(read_definition(name, text.read_text())).python_class()
rclpy.init()
node = rclpy.create_node('made')
publisher = node.create_publisher(made, topic, 10)
received = []
node.create_subscription(made, f'{topic}_back', received.append, 10, raw=True)
while not any(message.startswith(data) and len(message) < len(data) + 4 for message in received):
    publisher.publish(data)
    rclpy.spin_once(node, timeout_sec=0.05)
print('received', flush=True)
rclpy.spin(node)
"""


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('name', [
    'sensor_msgs/msg/CompressedImage', 'sensor_msgs/msg/JointState', 'std_msgs/msg/Empty',
    'diagnostic_msgs/msg/DiagnosticArray', 'rcl_interfaces/msg/ParameterEvent'])
def test_made_and_compiled_types_in_two_processes(
        node: Node, start: Start, tmp_path: Path, name: str) -> None:
    text, program = tmp_path / 'type.msg', tmp_path / 'made.py'
    text.write_text(whole_text(name))
    program.write_text(PROGRAM)
    definition, kind = installed_type(name), compiled_class(name)
    codec = MessageCodec(definition)
    sent = codec.write(random_message(definition, name, np.random.default_rng(5)))
    received: list[Any] = []
    publisher = node.create_publisher(kind, 'made_back', 10)
    node.create_subscription(kind, 'made', received.append, 10)
    other = start(str(program), name, 'made', str(text), sent.hex())
    spin_until(node, lambda: len(received) > 2)
    assert codec.write(codec.read(serialize_message(received[-1]))) == sent
    found, = node.get_publishers_info_by_topic('made')
    assert found.topic_type == name
    assert found.topic_type_hash.value == hash_of(kind) == TypeSupport(definition).type_hash

    def is_received() -> bool:
        publisher.publish(sent)
        return 'received\n' in other.output

    spin_until(node, is_received)
    client = node.create_client(GetTypeDescription, 'made/get_type_description')
    spin_until(node, client.service_is_ready)
    future = client.call_async(GetTypeDescription.Request(
        type_name=name, type_hash=str(found.topic_type_hash), include_type_sources=True))
    spin_until(node, future.done)
    answer = future.result()
    assert answer.successful, answer.failure_reason
    described = answer.type_description
    definitions = definition.types
    assert [described.type_description.type_name,
            *(other.type_name for other in described.referenced_type_descriptions)] == [
        name, *sorted(definitions.keys() - {name})]
    assert [field.name for field in described.type_description.fields] == [
        field.name for field in definitions[name].fields]
    assert {source.type_name: source.raw_file_contents.strip()
            for source in answer.type_sources} == {
        inner: definition.text.strip() for inner, definition in definitions.items()}


def test_type_without_a_compiled_package(node: Node) -> None:
    codec = MessageCodec(read_definition(VIDEO))
    video = message_type(VIDEO)
    assert message_type('foxglove_msgs/CompressedVideo') is video
    received: list[bytes] = []
    publisher = node.create_publisher(video, 'video', 10)
    node.create_subscription(video, 'video', received.append, 10, raw=True)
    sent = codec.write({'timestamp': {'sec': 5}, 'frame_id': 'eye', 'format': 'h264',
                        'data': np.arange(200_000) % 251})
    spin_until(node, lambda: publisher.get_subscription_count() > 0)
    publisher.publish(sent)
    spin_until(node, lambda: bool(received))
    assert received == [sent]
    assert dict(node.get_topic_names_and_types())['/video'] == [VIDEO]


def test_messages_of_a_made_type_are_refused(node: Node) -> None:
    video = message_type(VIDEO)
    with pytest.raises(TypeError, match=f'{VIDEO} has no messages in Python; publish bytes'):
        video()
    publisher = node.create_publisher(video, 'refused', 10)
    with pytest.raises(TypeError):
        publisher.publish(object())
    node.create_subscription(video, 'refused', print, 10)  # without raw=True
    with pytest.raises(MemoryError):
        spin_until(node, lambda: publisher.publish(bytes(28)) or False)


def test_compiled_class_is_preferred() -> None:
    name = 'sensor_msgs/msg/CompressedImage'
    assert message_type(name) is message_type('sensor_msgs/CompressedImage') is CompressedImage
    assert message_type(name, whole_text(name)) is CompressedImage
    older = message_type(name, 'uint8[] data')
    assert older is not CompressedImage
    assert message_type(name, 'uint8[]  data # the same') is older
    with pytest.raises(DefinitionError, match=f'{name} is in use with another definition'):
        message_type(name, 'uint8[9] data')
    assert message_type(name) is CompressedImage


def test_names_do_not_choose_what_is_imported(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / 'harmful'
    package.mkdir()
    package.joinpath('__init__.py').write_text('raise SystemExit("imported")')
    monkeypatch.syspath_prepend(tmp_path)
    for name in ('harmful', 'antigravity', 'opencv_tools', 'nothing_of_this_name'):
        with pytest.raises(DefinitionError, match='is not known'):
            message_type(f'{name}/msg/A')
    assert 'antigravity' not in sys.modules


def test_number_of_types_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, '_made', {})
    monkeypatch.setattr(module, '_MAX_TYPES', 2)
    for number in range(2):
        message_type(f'limit_msgs/msg/A{number}', 'int8 a')
    with pytest.raises(DefinitionError, match='2 types are, which is the limit'):
        message_type('limit_msgs/msg/A2', 'int8 a')
    message_type('limit_msgs/msg/A1', 'int8 a')


def test_every_array_and_string_is_described(node: Node) -> None:
    bases = ('bool', 'byte', 'char', 'int8', 'uint8', 'int16', 'uint16', 'int32', 'uint32',
             'int64', 'uint64', 'float32', 'float64', 'string', 'string<=7', 'wstring',
             'wstring<=7', 'B')
    text = '\n'.join(f'{base}{array} f{number}_{place}' for number, base in enumerate(bases)
                     for place, array in enumerate(('', '[3]', '[<=3]', '[]')))
    every = message_type('every_msgs/msg/Every', f'{text}{SEPARATOR}every_msgs/B\nint8 a')
    node.create_publisher(every, 'every', 10)
    found, = node.get_publishers_info_by_topic('every')
    assert found.topic_type_hash.value == hash_of(every)


def test_all_texts_are_found() -> None:
    assert {name.partition('/')[0] for name in installed_texts()} > {
        'sensor_msgs', 'geometry_msgs', 'std_msgs', 'nav_msgs', 'diagnostic_msgs'}


def walk(support: int, seen: dict[str, Any]) -> None:
    """Add the members of a type, and of those that it contains, by the name of the type."""
    find = type_support._Handle(type_support._TypeSupport.from_address(support).func)
    found = find(support, type_support._INTROSPECTION)
    members = type_support._Members.from_address(
        type_support._TypeSupport.from_address(found).data)
    name = f'{members.message_namespace.decode()}/{members.message_name.decode()}'
    if name not in seen:
        seen[name] = fields = []
        size = ctypes.sizeof(type_support._Member)
        for number in range(members.member_count):
            member = type_support._Member.from_address(members.members + number * size)
            fields.append((member.name, member.type_id, member.string_upper_bound, member.is_key,
                           member.is_array, member.array_size, member.is_upper_bound,
                           bool(member.members)))
            if member.members:
                walk(member.members, seen)


def test_members_of_every_compiled_type() -> None:
    assert len(installed_texts()) > 150
    for name in installed_texts():
        kind = compiled_class(name)
        compiled: dict[str, Any] = {}
        made: dict[str, Any] = {}
        walk(type_support._pointer(type(kind)._TYPE_SUPPORT, None), compiled)
        support = TypeSupport(installed_type(name))
        walk(support.address, made)
        assert made == compiled, name


def test_structures_remain_with_the_class(node: Node) -> None:
    kinds = [TypeSupport(read_definition(f'kept_msgs/msg/A{number}', 'int8 a')).python_class()
             for number in range(50)]
    gc.collect()
    for kind in kinds:
        node.create_publisher(kind, f'kept_{kind.__name__}', 10)
        assert hash_of(kind) == TypeSupport(
            read_definition(f'kept_msgs/msg/{kind.__name__}', 'int8 a')).type_hash


def test_type_of_a_package_without_messages() -> None:
    kind = message_type('std_srvs/msg/Window', 'bool is_open')
    assert kind.__name__ == 'Window'
    with pytest.raises(DefinitionError, match='std_srvs/msg/Shutter is not known'):
        message_type('std_srvs/msg/Shutter')


def test_known_text_is_not_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[str] = []

    def read_once(name: str, text: str | None) -> Any:
        read.append(name)
        return read_definition(name, text)

    monkeypatch.setattr(module, 'read_definition', read_once)
    kind = message_type('known_msgs/msg/A', 'int8 a')
    assert message_type('known_msgs/A', 'int8 a') is kind
    for _ in range(2):
        with pytest.raises(DefinitionError, match='in use with another definition'):
            message_type('known_msgs/msg/A', 'int8 b')
    assert read == 2 * ['known_msgs/msg/A']


def test_functions_under_a_lock_of_rmw_run_no_python() -> None:
    # Python may pass the GIL to a thread that waits for the same lock.
    support = TypeSupport(read_definition(VIDEO))
    structure = type_support._TypeSupport.from_address(support.address)
    find = type_support._Handle(structure.func)
    members = find(support.address, type_support._INTROSPECTION)
    inner = type_support._Handle(type_support._TypeSupport.from_address(members).func)
    getters = [type_support._Pointer(getattr(structure, name)) for name in (
        'get_type_hash_func', 'get_type_description_func', 'get_type_description_sources_func')]
    measure = type_support._MaxSize(
        type_support._Callbacks.from_address(structure.data).max_serialized_size)
    bounds = ctypes.create_string_buffer(b'\x03')
    files: list[str] = []
    sys.setprofile(lambda frame, event, _: files.append(frame.f_code.co_filename))
    try:
        found = [
            [find(support.address, kind) for kind in type_support._C + type_support._CPP],
            [inner(members, kind) for kind in type_support._C + type_support._CPP],
            [get(support.address) for get in getters], measure(bounds)]
    finally:
        sys.setprofile(None)
    assert type_support.__file__ not in files
    assert found[:2] == [[support.address, members, None, None], [None, members, None, None]]
    assert all(found[2]) and len({*found[2]}) == 3
    assert found[3] is None and bounds.raw[0] == 0
