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
from typing import Any

from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.jobs import convert_job, Job
from opencv_tools.datasets.plan import Plan
from opencv_tools.image.text import printable
from opencv_tools.remedies import installation

#: Address of a cluster on this machine, which ends with the command.
LOCAL = 'local'
_RETRIES = 3  # of a bag whose worker or node is lost
_MOST_WAITING = 1000  # bags that Ray knows at a time


def convert_on_ray(jobs: Sequence[Job], plan: Plan, address: str, memory: int,
                   ) -> Iterator[tuple[Job, str]]:
    """
    Convert bags on a Ray cluster, one processor a bag.

    :param address: address of the cluster, or ``LOCAL``.
    :param memory: memory in bytes that Ray reserves for a bag; 0 for none.
    :returns: an iterator over each bag and '' or its error, in the order in which they are done.
    :raises DatasetError: Ray is not installed, or the cluster cannot be reached.
    """
    ray = _connect(address)
    try:
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
    try:
        import ray
    except ImportError as err:
        raise DatasetError(f'--ray needs Ray, which cannot be imported ({err}); '
                           f'{installation("ray")}') from err
    try:
        ray.init(address=address, log_to_driver=False, logging_level='ERROR',
                 include_dashboard=False if address == LOCAL else None)
    except (ConnectionError, RuntimeError, ValueError) as err:
        raise DatasetError(f"the Ray cluster '{printable(address)}' cannot be used: "
                           f'{printable(err)}; start it with: ray start --head') from err
    return ray
