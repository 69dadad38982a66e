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

"""Definitions of the message types of topics, which need not be installed."""

from __future__ import annotations

from dataclasses import dataclass, field
import time
from typing import Any

from opencv_tools.base.text import printable
from opencv_tools.message_types.definition import (
    DefinitionError, full_name, read_definition, TypeDefinition)
from opencv_tools.message_types.description import type_hash
from opencv_tools.topics.errors import ROS_ERRORS
from opencv_tools.topics.topic_discovery import UNKNOWN_NODE
from rclpy.node import Node
from rclpy.task import Future
from rclpy.topic_endpoint_info import TopicEndpointInfo
from type_description_interfaces.srv import GetTypeDescription

_ANSWER_SECONDS = 20.0
_REPEAT_SECONDS = 2.0  # rmw_fastrtps drops an answer to a client that it discovers late
_FORGOTTEN_SECONDS = 60.0  # after the last call for a publisher, which has left
_MAX_QUESTIONS = 100  # at the same time; others wait for their turn
_MAX_TEXT = 1 << 18  # characters of an answer
_PARTICIPANT_BYTES = 12  # of an identifier of DDS, which name the process
_UNKNOWN_HASH = 'INVALID'  # of a publisher that names none


@dataclass
class _Question:
    """A question to a node about a type."""

    deadline: float
    wanted_at: float  # time of the last call of ``find`` for it
    client: Any = None  # until the name of the node is discovered
    asked_at: float = 0.0
    futures: list[Future] = field(default_factory=list)


# Type, hash, node that is asked ('' until its name is discovered), and its process, because a node
# that was started again is asked anew.
_Key = tuple[str, str, str, bytes]


class TopicTypes:
    """
    Find the definitions of the types that publishers use; used by one thread.

    A definition is used if its hash is that of the publisher. The installed one is tried first,
    or that of this package; then the node of the publisher is asked.
    """

    def __init__(self, node: Node) -> None:
        """
        Create a finder.

        :param node: node that asks; its executor has to spin.
        """
        self._node = node
        self._questions: dict[_Key, _Question] = {}  # the longest not wanted first
        self._found: dict[tuple[str, str], TypeDefinition] = {}

    def find(self, publisher: TopicEndpointInfo) -> TypeDefinition | None:
        """
        Return the definition of the type of a publisher.

        :returns: the definition; None while the node of the publisher is asked.
        :raises DefinitionError: the definition cannot be found.
        """
        name, wanted = full_name(publisher.topic_type), str(publisher.topic_type_hash)
        self._forget_old()
        if (name, wanted) not in self._found:
            node = '' if publisher.node_name == UNKNOWN_NODE else (
                f'{publisher.node_namespace.rstrip("/")}/{publisher.node_name}')
            process = bytes(publisher.endpoint_gid)[:_PARTICIPANT_BYTES]
            key = name, wanted, node, process
            known = None if key in self._questions else _known(name, wanted)
            found = known or self._ask(key)
            if found is None:
                return None
            self._found[name, wanted] = found
        return self._found[name, wanted]

    def _forget_old(self) -> None:
        """End the questions about publishers that have left."""
        now = time.monotonic()
        while self._questions:
            key, question = next(iter(self._questions.items()))
            if now < question.wanted_at + _FORGOTTEN_SECONDS:
                break
            self._end(key)

    def _ask(self, key: _Key) -> TypeDefinition | None:
        """Ask the node of a publisher, and return its answer when that is here."""
        name, wanted, node, process = key
        now = time.monotonic()
        question = self._questions.pop(key, None) or self._questions.pop(
            (name, wanted, '', process), None)
        if question is None:
            if len(self._questions) >= _MAX_QUESTIONS:
                return None
            question = _Question(now + _ANSWER_SECONDS, now)
        question.wanted_at = now
        self._questions[key] = question  # now the last one
        if question.client is None and node:
            try:
                question.client = self._node.create_client(
                    GetTypeDescription, f'{node}/get_type_description')
            except ROS_ERRORS as err:
                self._end(key)
                raise DefinitionError(
                    f'the definition of {name} is not installed, and {printable(node)} cannot be '
                    'asked for it') from err
        if (question.client and now >= question.asked_at + _REPEAT_SECONDS
                and question.client.service_is_ready()):
            question.asked_at = now
            question.futures.append(question.client.call_async(GetTypeDescription.Request(
                type_name=name, type_hash=wanted, include_type_sources=True)))
        for future in question.futures:
            if future.done():
                self._end(key)
                return _answered(name, wanted, printable(node), future.result())
        if now < question.deadline:
            return None
        self._end(key)
        raise DefinitionError(
            f'the definition of {name} is not installed, and {printable(node) or "its node"} '
            f'has not sent it within {_ANSWER_SECONDS:g} s; install the package '
            f'{name.partition("/")[0]}')

    def _end(self, key: _Key) -> None:
        client = self._questions.pop(key).client
        if client:
            self._node.destroy_client(client)


def _known(name: str, wanted: str) -> TypeDefinition | None:
    """Return the installed definition or that of this package, if it has the right hash."""
    try:
        known = read_definition(name)
    except DefinitionError:
        return None
    return known if wanted in (_UNKNOWN_HASH, _hash(known)) else None


def _answered(name: str, wanted: str, node: str, response: Any) -> TypeDefinition:
    """Return the definition in an answer."""
    texts = {source.type_name: source.raw_file_contents for source in response.type_sources
             if source.encoding == 'msg'}
    if not response.successful or name not in texts:
        raise DefinitionError(f'the definition of {name} is not installed, and {node} does not '
                              'know its text')
    separator = f'\n{"=" * 80}\nMSG: '
    text = separator.join([texts.pop(name), *(
        f'{other}\n{body}' for other, body in texts.items())])
    if len(text) > _MAX_TEXT:
        raise DefinitionError(f'the definition of {name} of {node} has {len(text)} characters; at '
                              f'most {_MAX_TEXT} are read')
    found = read_definition(name, text)
    if wanted not in (_UNKNOWN_HASH, _hash(found)):
        raise DefinitionError(f'the definition of {name} of {node} is not that of its messages')
    return found


def _hash(definition: TypeDefinition) -> str:
    """Return the hash of a type as publishers name it."""
    return f'RIHS01_{type_hash(definition).hex()}'
