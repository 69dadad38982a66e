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

"""A topic that is recorded beside the frames, and the account of its messages."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from opencv_tools.bags.writing import BagChannel
from opencv_tools.topics.message_reader import MessageReader
from opencv_tools.topics.order import FrameOrder
from rclpy.qos import QoSProfile


@dataclass(eq=False)
class RecordedTopic:
    """A topic that is recorded, and the account of its messages."""

    reader: MessageReader
    channel: BagChannel
    message_class: type
    qos: QoSProfile
    order: FrameOrder = field(default_factory=FrameOrder)
    publishers: frozenset[bytes] = frozenset()  # identifiers of those that are followed
    received: int = 0
    written: int = 0
    unwritten: Counter[str] = field(default_factory=Counter)  # by the kind of `Unwritten`

    def account(self, with_type: bool = False) -> str:
        """
        Return the account: received = written + dropped + failed + not processed + skipped.

        :param with_type: whether the type of the messages is named.
        """
        kind = f' ({self.channel.type_name})' if with_type else ''
        return (f'{self.channel.topic}{kind}: {self.received} messages received, {self.written} '
                f'written{self._unwritten("dropped", "failed")}, {self.order.count} lost in '
                'transit' + ('' if self.order.is_complete else ' since the first received message')
                + self._unwritten('not processed', 'skipped'))

    def _unwritten(self, *names: str) -> str:
        return ''.join(f', {count} {name}' for name in names if (count := self.unwritten[name]))
