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

"""A process that asks a node for the definitions of types, see `TopicTypes`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import json
import os
import sys
import time
from typing import Any

from opencv_tools.base.worker import begin_work
import rclpy
from rclpy.parameter import Parameter
from type_description_interfaces.srv import GetTypeDescription

#: Characters of an answer that are read.
MAX_TEXT = 1 << 18
_REPEAT_SECONDS = 2.0  # rmw_fastrtps drops an answer to a client that it discovers late

#: Name and hash of a type.
Question = tuple[str, str]
#: Texts of definitions by the name of the type, or the number of characters of too large ones.
Answer = Mapping[str, str] | int


def main() -> None:
    """
    Write each answer as a line of JSON: the number of the question from 0, and the answer.

    Arguments are the name of the node, the questions as JSON, and the limits: elapsed seconds,
    which are those of processor time as well, and bytes of memory.
    """
    node, questions, seconds, memory = sys.argv[1:]
    begin_work(int(memory), max(1, int(float(seconds))))
    rclpy.init(args=['--ros-args', '--disable-external-lib-logs', '--disable-rosout-logs'])
    _ask(node, [(name, wanted) for name, wanted in json.loads(questions)],
         time.monotonic() + float(seconds))
    rclpy.shutdown()


def _ask(name: str, questions: Sequence[Question], deadline: float) -> None:
    """Ask until each question is answered, or until the deadline of `time.monotonic`."""
    node = rclpy.create_node(
        f'_type_questions_{os.getpid()}', use_global_arguments=False, enable_rosout=False,
        start_parameter_services=False, parameter_overrides=[
            Parameter('start_type_description_service', value=False)])
    client = node.create_client(GetTypeDescription, f'{name}/get_type_description')
    unanswered = dict(enumerate(questions))
    futures: list[tuple[int, Any]] = []
    asked_at = 0.0
    while unanswered and (now := time.monotonic()) < deadline:
        if now >= asked_at + _REPEAT_SECONDS and client.service_is_ready():
            asked_at = now
            futures += [(number, client.call_async(GetTypeDescription.Request(
                type_name=type_name, type_hash=wanted, include_type_sources=True)))
                for number, (type_name, wanted) in unanswered.items()]
        rclpy.spin_once(node, timeout_sec=0.1)
        for number, future in futures:
            if future.done() and unanswered.pop(number, None):
                print(json.dumps([number, _answer(future.result())]), flush=True)
        futures = [(number, future) for number, future in futures if number in unanswered]


def _answer(response: Any) -> Answer:
    texts = {source.type_name: source.raw_file_contents for source in response.type_sources
             if source.encoding == 'msg'} if response.successful else {}
    size = sum(map(len, texts.values()))
    return size if size > MAX_TEXT else texts
