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

"""Messages of unknown origin: each is read, counted as damaged, or an error of data sets."""

from __future__ import annotations

from dataset_bags import BEGAN, joints_entry, jpeg_entry, TYPES
from hypothesis import given, settings, strategies as st
import numpy as np
from opencv_tools.bags.reading import BagMessage, BagTopic
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.plan import NumbersSource
from opencv_tools.datasets.samples import NumbersReader, Samples
import pytest

KIND = 'sensor_msgs/msg/JointState'
JOINTS = BagTopic('/joints', KIND, definition=TYPES.generate_msgdef(KIND, ros_version=2)[0])
IMAGES = BagTopic('/images', 'sensor_msgs/msg/CompressedImage')
MESSAGES = {JOINTS: joints_entry(BEGAN, [1, 2], ['a', 'b']).data,
            IMAGES: jpeg_entry(1, BEGAN).data}


def samples_of(topic: BagTopic) -> Samples:
    if topic == IMAGES:
        return Samples(topic)
    source = NumbersSource('/joints', ('position',), ('a', 'b'))
    return Samples(topic, source)


def message(topic: BagTopic, data: bytes, log_ns: int = BEGAN) -> BagMessage:
    return BagMessage(topic, log_ns, lambda: memoryview(data))


@settings(max_examples=150)
@given(st.sampled_from([JOINTS, IMAGES]), st.data())
def test_no_message_is_too_hostile(topic: BagTopic, data: st.DataObject) -> None:
    content = bytearray(MESSAGES[topic][:data.draw(st.integers(0, len(MESSAGES[topic])))])
    for place in data.draw(st.lists(st.integers(0, max(0, len(content) - 1)), max_size=4)):
        content[place:place + 1] = data.draw(st.binary(max_size=2))
    log_ns = data.draw(st.sampled_from([BEGAN, 0, (1 << 63) - 1, 1 << 63, (1 << 64) - 1]))
    samples = samples_of(topic)
    try:
        samples.add(message(topic, bytes(content), log_ns))
        samples.add(message(topic, MESSAGES[topic]))
        assert samples.count == 2 == samples.damaged + len(samples.logs)
        assert len(samples.logs) == len(samples.stamps) == len(samples.places)
        assert len(samples.values) == (2 * len(samples.logs) if topic == JOINTS else 0)
        samples.times('stamp', 'a')
    except DatasetError as err:
        assert str(err).isprintable()


def test_topic_without_readable_messages_is_an_error() -> None:
    samples = samples_of(JOINTS)
    for clock in ('stamp', 'log'):
        with pytest.raises(DatasetError, match=r'x \(/joints\) has no message that can be read'):
            samples.times(clock, 'x')
        samples.add(message(JOINTS, b'\0\1'))
    assert samples.damaged == 2


def test_big_endian_stamps() -> None:
    samples = samples_of(IMAGES)
    samples.add(message(IMAGES, b'\0\0\0\0' + np.array([7, 9], '>u4').tobytes()))
    assert samples.times('stamp', 'x').tolist() == [7_000_000_009]


def test_list_of_times_is_no_stamp() -> None:
    kind = 'builtin_interfaces/Time'
    text = (f'{kind} stamp\nfloat64 value\n{"=" * 80}\nMSG: {kind}\nint32 sec\nuint32 nanosec\n')
    for definition, has_stamp in ((text, True), (text.replace('Time s', 'Time[] s'), False)):
        topic = BagTopic('/a', 'my_msgs/msg/Timed', definition=definition)
        assert NumbersReader(topic).has_stamp == has_stamp
