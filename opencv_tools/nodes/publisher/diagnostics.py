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

"""Status of the source, published on ``/diagnostics`` once a second."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from opencv_tools.topics.timers import create_steady_timer
from rclpy.node import Node

_PERIOD = 1.0


@dataclass(frozen=True, kw_only=True)
class SourceStatus:
    """
    Status of a source.

    :param description: negotiated format; '' while the source is closed.
    :param unavailable_reason: reason why the source is unavailable; '' while it is open or paused.
    :param paused: whether capturing is paused.
    :param missed: number of camera frames that were not read in time.
    :param dropped: number of frames that could not be read or published.
    :param awaited: number of subscribers to wait for before the first frame; 0 after the wait.
    """

    source: str
    description: str
    unavailable_reason: str
    paused: bool
    missed: int
    dropped: int
    reconnects: int
    awaited: int = 0


class Diagnostics:
    """Publish the status of a source; frames are counted on any thread."""

    def __init__(self, node: Node, source_status: Callable[[], SourceStatus]) -> None:
        self._node = node
        self._source_status = source_status
        self._lock = threading.Lock()
        self._ages: list[float] = []
        self._since = time.monotonic()
        self._lost_before = 0
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        create_steady_timer(node, _PERIOD, self._report)

    def count(self, age: float = 0.0) -> None:
        """
        Count a frame.

        :param age: seconds from capture to publication; 0.0 without subscribers.
        """
        with self._lock:
            self._ages.append(age)

    def _report(self) -> None:
        """Publish the status of the last period."""
        now = time.monotonic()
        with self._lock:
            ages, self._ages = self._ages, []
        seconds, self._since = now - self._since, now
        source_status = self._source_status()
        lost = source_status.missed + source_status.dropped
        level, message = _level_and_message(source_status, len(ages), lost - self._lost_before)
        self._lost_before = lost
        values = {
            'source': source_status.source, 'format': source_status.description,
            'rate': f'{len(ages) / seconds:.1f} Hz',
            'age': f'{1000 * max(ages, default=0.0):.1f} ms at most',
            'dropped': source_status.dropped, 'missed': source_status.missed,
            'reconnects': source_status.reconnects}
        status = DiagnosticStatus(
            level=level, name=f'{self._node.get_fully_qualified_name().lstrip("/")}: source',
            message=message, hardware_id=source_status.source,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)


def _level_and_message(source_status: SourceStatus, frames: int, lost: int) -> tuple[bytes, str]:
    """Return the diagnostic level and message of a status."""
    if source_status.paused:
        return DiagnosticStatus.OK, 'paused'
    if source_status.unavailable_reason:
        return DiagnosticStatus.ERROR, source_status.unavailable_reason
    if lost > 0:
        return DiagnosticStatus.WARN, f'{lost} frames lost in the last second'
    if source_status.awaited and not frames:
        return DiagnosticStatus.OK, f'waiting for {source_status.awaited} subscriber(s)'
    return DiagnosticStatus.OK, 'publishing' if frames else 'no frame in the last second'
