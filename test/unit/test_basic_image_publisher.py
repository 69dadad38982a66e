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

"""The node of the publisher in this process: changes of its parameters while frames flow."""

from __future__ import annotations

from collections.abc import Iterator

from conftest import spin_until
from opencv_tools.basic_image_publisher import ImagePublisher
from opencv_tools.frames import Frame, FrameSubscriber
from opencv_tools.image_filter import PARAMETERS as FILTER
from opencv_tools.nodes.parameters import Parameter
from opencv_tools.nodes.publisher.parameters import PARAMETERS
from opencv_tools.nodes.subscriber.parameters import PARAMETERS as RECORDER
from opencv_tools.viewer.parameters import PARAMETERS as VIEWER
import pytest
import rclpy

FRAMES = 3  # after a change; one may have been on its way


def extremes(parameter: Parameter) -> list[float]:
    """Return the numbers at the bounds of a parameter, [] for one that cannot be changed."""
    if not parameter.changeable or isinstance(parameter.default, str | bool):
        return []
    zero = [0] if parameter.or_zero else []
    return [*zero, *(parameter.bounds or parameter.choices)]


@pytest.fixture
def publisher(domain: int) -> Iterator[ImagePublisher]:
    rclpy.init(domain_id=domain, args=[
        '--ros-args', '-p', 'source:=pattern:64x48@50', '-p', 'publish_rate:=40.0'])
    created = ImagePublisher()
    yield created
    created.close()
    created.destroy_node()
    rclpy.shutdown()


def test_numbers_at_their_bounds_and_back(publisher: ImagePublisher) -> None:
    frames: list[Frame] = []
    subscriber = FrameSubscriber(publisher, 'video_frames', frames.append, encoding='', every=True)

    def set_number(name: str, number: float) -> None:
        kind = type(publisher.get_parameter(name).value)
        (result,) = publisher.set_parameters([rclpy.Parameter(name, value=kind(number))])
        assert result.successful, result.reason

    def wait_for_frames() -> None:
        count = len(frames) + FRAMES
        spin_until(publisher, lambda: len(frames) >= count)

    numbers = {found.name: extremes(found) for found in PARAMETERS if extremes(found)}
    assert len(numbers) > 10
    wait_for_frames()
    for name, values in numbers.items():
        before = publisher.get_parameter(name).value
        for value in values:
            set_number(name, value)
            set_number(name, before)
            wait_for_frames()
    subscriber.destroy()


def test_other_nodes_have_no_other_number_to_change() -> None:
    # It would have to be in the test above.
    tried = {found.name: extremes(found) for found in PARAMETERS}
    assert [found.name for table in (FILTER, RECORDER, VIEWER) for found in table
            if extremes(found) and extremes(found) != tried.get(found.name)] == []
