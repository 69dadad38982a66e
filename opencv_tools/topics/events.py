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

"""Publishers and subscriptions that one thread may destroy while an executor spins in another."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, TypeVar

from rclpy.event_handler import EventHandler
from rclpy.exceptions import InvalidHandle
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

_Entity = TypeVar('_Entity', Publisher, Subscription)


def destroyable(entity: _Entity) -> _Entity:
    """
    Let any thread destroy a publisher or a subscription.

    An executor that has just found its events would raise an exception of rclpy, and end.

    :param entity: new publisher or subscription.
    :returns: the same.
    """
    events: Any = entity.event_handlers  # rclpy's own type is wrong
    for event in events:
        event.__class__ = _Event
    return entity


class _Event(EventHandler):
    """An event that does not come after its destruction."""

    def add_to_wait_set(self, wait_set: Any) -> None:
        with suppress(InvalidHandle):
            super().add_to_wait_set(wait_set)

    def take_data(self) -> Any:
        with suppress(InvalidHandle):
            return super().take_data()
        return None
