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

"""Conversion of bags on a Ray cluster, whose nodes all see the bags and the parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import logging
import os
import signal
import socket
import threading
from typing import Any

from opencv_tools.base.remedies import installation
from opencv_tools.base.text import printable
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.jobs import convert_job, Job
from opencv_tools.datasets.plan import Plan

#: Address of a cluster on this machine, which ends with the command.
LOCAL = 'local'
_RETRIES = 3  # of a bag whose worker or node is lost
_MOST_WAITING = 1000  # bags that Ray knows at a time
_CONNECT_SECONDS = 5.0


def convert_on_ray(jobs: Sequence[Job], plan: Plan, address: str, memory: int,
                   ) -> Iterator[tuple[Job, str]]:
    """
    Convert bags on a Ray cluster, one processor a bag.

    :param address: address of the cluster, or ``LOCAL``.
    :param memory: memory in bytes that Ray reserves for a bag; 0 for none.
    :returns: an iterator over each bag and '' or its error, in the order in which they are done.
    :raises DatasetError: Ray is not installed, or the cluster cannot be reached or is too small.
    """
    ray = _connect(address)
    try:
        _check_room(ray, memory)
        options: dict[str, Any] = {'num_cpus': 1, 'max_retries': _RETRIES}
        if memory:
            options['memory'] = memory
        task = ray.remote(**options)(convert_job)
        shared = ray.put(plan)
        waiting: dict[Any, Job] = {}
        rest = iter(jobs)
        while True:
            for job in rest:
                waiting[task.remote(job, shared, 1)] = job
                if len(waiting) >= _MOST_WAITING:
                    break
            if not waiting:
                return
            done, _ = ray.wait([*waiting])
            for reference in done:
                job = waiting.pop(reference)
                try:
                    yield job, ray.get(reference)
                except ray.exceptions.RayError as err:
                    yield job, f'Ray: {printable(str(err).strip().splitlines()[-1], 500)}'
    finally:
        ray.shutdown()


def _connect(address: str) -> Any:
    if address != LOCAL:
        _check_listening(address)
        # Ray's 20 attempts of 36 s would be twelve minutes for a port of another program.
        os.environ.setdefault('RAY_NUM_REDIS_GET_RETRIES', '1')
    # Ray writes errors of its own to the terminal while a signal ends the command.
    os.environ.setdefault('RAY_BACKEND_LOG_LEVEL', 'fatal')
    try:
        import ray
    except ImportError as err:
        raise DatasetError(f'--ray needs Ray, which cannot be imported ({err}); '
                           f'{installation("ray")}') from err
    handler = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR,
                 include_dashboard=False if address == LOCAL else None)
    except (ray.exceptions.RayError, OSError, RuntimeError, ValueError) as err:
        raise _unusable(address, err) from err
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)  # Ray's own exits with status 15
    return ray


def _check_room(ray: Any, memory: int) -> None:
    """
    Check that a node has the memory for a bag, for which Ray would wait for ever.

    :raises DatasetError: no node has it.
    """
    nodes = [node['Resources'] for node in ray.nodes() if node['Alive']]
    largest = max((node.get('memory', 0) for node in nodes if node.get('CPU')), default=memory)
    if largest < memory:
        raise DatasetError(f'no node of the Ray cluster has {memory / 1e6:.0f} MB of memory for '
                           f'a bag, the largest one has {largest / 1e6:.0f} MB; give less with '
                           '--ray-memory')


def _check_listening(address: str) -> None:
    """
    Check that a program listens at an address, for which Ray would wait for minutes.

    :raises DatasetError: it does not.
    """
    host, _, port = address.removeprefix('ray://').rpartition(':')
    if not host or not port.isdecimal():
        return  # auto, or a name that Ray knows
    try:
        socket.create_connection((host.strip('[]'), int(port)), _CONNECT_SECONDS).close()
    except (OSError, OverflowError) as err:
        raise _unusable(address, err) from err


def _unusable(address: str, err: Exception) -> DatasetError:
    reason = getattr(err, 'strerror', None) or str(err).strip().partition('\n')[0]
    return DatasetError(f"the Ray cluster '{printable(address)}' cannot be used: "
                        f'{printable(reason, 500)}; start it with: ray start --head')
