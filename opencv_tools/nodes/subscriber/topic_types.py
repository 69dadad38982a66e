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

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
import json
import os
from subprocess import DEVNULL, Popen, TimeoutExpired
from tempfile import TemporaryFile
import time

from opencv_tools.base.text import printable
from opencv_tools.base.worker import worker_command
from opencv_tools.message_types.definition import (
    DefinitionError, full_name, read_definition, TypeDefinition)
from opencv_tools.message_types.description import type_hash
from opencv_tools.nodes.subscriber.type_questions import Answer, MAX_TEXT, Question
from opencv_tools.topics.topic_discovery import UNKNOWN_NODE
from rclpy.topic_endpoint_info import TopicEndpointInfo

_ANSWER_SECONDS = 20.0
_END_SECONDS = 5.0  # of a process, after that
_FORGOTTEN_SECONDS = 60.0  # after the last call for a publisher, which has left
_MAX_QUESTIONS = 100  # at the same time; others wait for their turn
_MAX_PROCESSES = 2
_MAX_REFUSED = 128  # nodes that are remembered
_MEMORY = 1_500_000_000  # bytes of address space of a process, half of which is for answers
_PARTICIPANT_BYTES = 12  # of an identifier of DDS, which name the process
_UNKNOWN_HASH = 'INVALID'  # of a publisher that names none


class _Inquiry:
    """A process that asks a node for the definitions of types."""

    def __init__(self, node: str, questions: Iterable[Question]) -> None:
        self.questions = [*questions]
        self._ended_at = time.monotonic() + _ANSWER_SECONDS + _END_SECONDS
        self._output = TemporaryFile()  # noqa: SIM115 (it is open as long as the process)
        # A process that is killed leaves nothing in /dev/shm.
        self._process = Popen(
            worker_command('opencv_tools.nodes.subscriber.type_questions', node, json.dumps(
                self.questions), str(_ANSWER_SECONDS), str(_MEMORY)),
            env={**os.environ, 'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4'}, stdin=DEVNULL,
            stdout=self._output, stderr=DEVNULL, start_new_session=True)

    @property
    def is_running(self) -> bool:
        """Whether the process has not ended; one that takes too long is killed."""
        if self._process.poll() is None and time.monotonic() > self._ended_at:
            self.close()
        return self._process.returncode is None

    @property
    def failure(self) -> str:
        """Why the process has not ended as it should, as a part of a sentence; '' if it has."""
        status = self._process.returncode
        reason = (f'the process that asked it ended with status {status}: its answer takes too '
                  'much memory or time')
        return reason if status else ''

    def answers(self) -> dict[Question, Answer]:
        """Return the answers, after the end of the process."""
        self._output.seek(0)
        answers: dict[Question, Answer] = {}
        for line in self._output:
            with suppress(ValueError):  # a line that a killed process has not finished
                number, answer = json.loads(line)
                answers[self.questions[number]] = answer
        self._output.close()
        return answers

    def close(self) -> None:
        """End the process, which cannot be read any more."""
        self._process.kill()
        with suppress(TimeoutExpired):
            self._process.wait(_END_SECONDS)


# Node that is asked ('' until its name is discovered), and its process, because a node that was
# started again is asked anew.
_Node = tuple[str, bytes]


@dataclass
class _Pending:
    """A question to a node that is not answered."""

    deadline: float  # of an unknown name of the node, then of the answer
    wanted_at: float  # time of the last call of ``find`` for it
    is_asked: bool = False
    answer: Answer | None = None


class TopicTypes:
    """
    Find the definitions of the types that publishers use; used by one thread.

    A definition is used if its hash is that of the publisher. The installed one is tried first,
    or that of this package; then the node of the publisher is asked. A process of its own asks,
    because rclpy converts an answer of any size before it can be looked at.
    """

    def __init__(self) -> None:
        self._questions: dict[tuple[Question, _Node], _Pending] = {}  # longest not wanted first
        self._inquiries: dict[_Node, _Inquiry] = {}
        self._refused: dict[_Node, str] = {}  # reasons by node, whose answer has ended a process
        self._found: dict[Question, TypeDefinition] = {}

    def find(self, publisher: TopicEndpointInfo) -> TypeDefinition | None:
        """
        Return the definition of the type of a publisher.

        :returns: the definition; None while the node of the publisher is asked.
        :raises DefinitionError: the definition cannot be found.
        """
        question = full_name(publisher.topic_type), str(publisher.topic_type_hash)
        self._forget_old()
        if question not in self._found:
            name = '' if publisher.node_name == UNKNOWN_NODE else (
                f'{publisher.node_namespace.rstrip("/")}/{publisher.node_name}')
            node = name, bytes(publisher.endpoint_gid)[:_PARTICIPANT_BYTES]
            known = None if (question, node) in self._questions else _known(*question)
            found = known or self._ask(question, node)
            if found is None:
                return None
            self._found[question] = found
        return self._found[question]

    def close(self) -> None:
        """End the processes that ask."""
        self._questions.clear()
        for inquiry in self._inquiries.values():
            inquiry.close()

    def _forget_old(self) -> None:
        """End the questions about publishers that have left, and the processes without any."""
        now = time.monotonic()
        while self._questions:
            key, pending = next(iter(self._questions.items()))
            if now < pending.wanted_at + _FORGOTTEN_SECONDS:
                break
            del self._questions[key]
        for node, inquiry in [*self._inquiries.items()]:
            if not any((question, node) in self._questions for question in inquiry.questions):
                self._inquiries.pop(node).close()
            elif not inquiry.is_running:
                self._read(node, self._inquiries.pop(node))

    def _read(self, node: _Node, inquiry: _Inquiry) -> None:
        """Remember the answers to the questions that are still asked."""
        for question, answer in inquiry.answers().items():
            if (question, node) in self._questions:
                self._questions[question, node].answer = answer
        if inquiry.failure:
            self._refused[node] = inquiry.failure
            while len(self._refused) > _MAX_REFUSED:
                del self._refused[next(iter(self._refused))]

    def _ask(self, question: Question, node: _Node) -> TypeDefinition | None:
        """Ask the node of a publisher, and return its answer when that is here."""
        (type_name, wanted), (name, process) = question, node
        now = time.monotonic()
        pending = self._questions.pop((question, node), None) or self._questions.pop(
            (question, ('', process)), None)
        if pending is None:
            if len(self._questions) >= _MAX_QUESTIONS:
                return None
            pending = _Pending(now + _ANSWER_SECONDS, now)
        if pending.answer is not None:
            return _answered(type_name, wanted, printable(name), pending.answer)
        reason = (f'the definition of {type_name} is not installed, and '
                  f'{printable(name) or "its node"}')
        if node in self._refused:
            raise DefinitionError(f'{reason} does not send it: {self._refused[node]}')
        if (now >= pending.deadline and node not in self._inquiries
                and (pending.is_asked or not name)):
            raise DefinitionError(f'{reason} has not sent it within {_ANSWER_SECONDS:g} s; '
                                  f'install the package {type_name.partition("/")[0]}')
        pending.wanted_at = now
        self._questions[question, node] = pending  # now the last one
        if name and node not in self._inquiries and len(self._inquiries) < _MAX_PROCESSES:
            asked = [other for other, owner in self._questions if owner == node]
            for other in asked:
                self._questions[other, node].is_asked = True
                self._questions[other, node].deadline = now + _ANSWER_SECONDS
            try:
                self._inquiries[node] = _Inquiry(name, asked)
            except OSError as err:
                del self._questions[question, node]
                raise DefinitionError(f'{reason} cannot be asked for it: {err.strerror}') from err
        return None


def _known(name: str, wanted: str) -> TypeDefinition | None:
    """Return the installed definition or that of this package, if it has the right hash."""
    try:
        known = read_definition(name)
    except DefinitionError:
        return None
    return known if wanted in (_UNKNOWN_HASH, _hash(known)) else None


def _answered(name: str, wanted: str, node: str, answer: Answer) -> TypeDefinition:
    """Return the definition in an answer."""
    if isinstance(answer, int):
        raise DefinitionError(f'the definition of {name} of {node} has {answer} characters; at '
                              f'most {MAX_TEXT} are read')
    if name not in answer:
        raise DefinitionError(f'the definition of {name} is not installed, and {node} does not '
                              'know its text')
    separator = f'\n{"=" * 80}\nMSG: '
    text = separator.join([answer[name], *(
        f'{other}\n{body}' for other, body in answer.items() if other != name)])
    found = read_definition(name, text)
    if wanted not in (_UNKNOWN_HASH, _hash(found)):
        raise DefinitionError(f'the definition of {name} of {node} is not that of its messages')
    return found


def _hash(definition: TypeDefinition) -> str:
    """Return the hash of a type as publishers name it."""
    return f'RIHS01_{type_hash(definition).hex()}'
