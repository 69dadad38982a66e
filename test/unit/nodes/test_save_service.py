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

"""Calls of ``~/save``: each is answered, however many there are."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from conftest import executor_of
from opencv_tools.basic_image_subscriber import ImageSubscriber
from opencv_tools.nodes.subscriber.session import SaveRequests
import pytest
import rclpy
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_srvs.srv import Trigger
from waiting import LONGEST_SECONDS, wait_until, work

CALLS = 50


@pytest.fixture
def executor(node: Node) -> Iterator[SingleThreadedExecutor]:
    """Create an executor of the node."""
    with executor_of(node) as made:
        yield made


def create_client(node: Node) -> Client:
    return node.create_client(Trigger, '~/save', qos_profile=QoSProfile(depth=2 * CALLS))


def spin_until_all(executor: SingleThreadedExecutor, futures: list[Future]) -> None:
    wait_until(lambda: all(future.done() for future in futures), 'the answers',
               partial(executor.spin_once, timeout_sec=0.05),
               answers=lambda: sum(future.done() for future in futures), work=work)


def call(executor: SingleThreadedExecutor, client: Client, requests: SaveRequests) -> list[Future]:
    """Call the service many times before the node takes a call."""
    wait_until(client.service_is_ready, 'the service')
    futures = [client.call_async(Trigger.Request()) for _ in range(CALLS)]
    wait_until(lambda: len(requests._waiting) == CALLS, 'the calls',
               partial(executor.spin_once, timeout_sec=0.05),
               calls=lambda: len(requests._waiting))
    return futures


def test_simultaneous_calls(
        executor: SingleThreadedExecutor, node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('opencv_tools.nodes.subscriber.session._TIMEOUT_SECONDS',
                        LONGEST_SECONDS)
    requests = SaveRequests(node)
    futures = call(executor, create_client(node), requests)
    taken = requests.pop_all()
    assert (len(taken), requests.pop_all()) == (CALLS, [])
    requests.complete(taken, Path('/a/file.png'))
    spin_until_all(executor, futures)
    assert {(future.result().success, future.result().message)
            for future in futures} == {(True, '/a/file.png')}


def test_waiting_calls_at_shutdown(
        tmp_path: Path, domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('opencv_tools.nodes.subscriber.session._TIMEOUT_SECONDS',
                        LONGEST_SECONDS)
    rclpy.init(args=['--ros-args', '-p', 'mode:=on_request', '-p', f'output_dir:={tmp_path}'],
               domain_id=domain)
    subscriber = ImageSubscriber()
    executor = SingleThreadedExecutor()
    executor.add_node(subscriber)
    client = create_client(subscriber)
    futures = call(executor, client, subscriber._session.requests)
    futures.append(client.call_async(Trigger.Request()))  # taken last
    assert subscriber.close() == 0
    spin_until_all(executor, futures)
    assert {(future.result().success, future.result().message)
            for future in futures} == {(False, 'the node is shutting down')}
    executor.shutdown()
    subscriber.destroy_node()
    rclpy.shutdown()
