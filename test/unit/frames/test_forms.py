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

"""Arrays without a compressed form: each output topic of a frame stands alone."""

from __future__ import annotations

from conftest import spin_until
from images import random_image
import numpy as np
from opencv_tools.frames import FramePublisher, FrameSubscriber
from opencv_tools.frames.frame import Frame
from opencv_tools.topics import frame_topics
import pytest
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header

DTYPES = {'8U': np.uint8, '8S': np.int8, '16U': np.uint16, '16S': np.int16, '32S': np.int32,
          '32F': np.float32, '64F': np.float64}
WITH_FORM = [f'{bits}C{channels}' for bits in ('8U', '16U') for channels in (1, 3, 4)]
ARRAYS = [f'{bits}C{channels}' for bits in DTYPES for channels in (1, 2, 3, 4)]
LOANS = ['yuv422', 'yuv422_yuy2', 'nv12', 'nv24', 'bayer_gbrg16', 'rgb8', '32FC7']


@pytest.fixture(autouse=True)
def _quick_return(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_topics, '_RETURN_SECONDS', 0)


def test_every_array_for_every_kind_of_reader(node: Node, camera: Node) -> None:
    publisher = FramePublisher(camera, 'camera/image')
    received: dict[str, list[Frame]] = {name: [] for name in ('raw', 'auto', 'shm', 'compressed')}
    subscribers = [FrameSubscriber(node, '/front/camera/image', frames.append, encoding='',
                                   every=True, transport=transport)
                   for transport, frames in received.items()]
    plain: list[CompressedImage] = []
    node.create_subscription(CompressedImage, '/front/camera/image/compressed', plain.append, 10)
    def is_received(name: str) -> bool:
        return all(frames and frames[-1].frame_id == name for transport, frames in received.items()
                   if transport != 'compressed')

    def warm_up() -> bool:
        publisher.publish(random_image('bgr8', 4, 6), Header(frame_id='first'))
        return is_received('first') and publisher._topics.count_compressed() == 2

    spin_until(node, warm_up)
    sent = []
    for encoding in [*ARRAYS, *LOANS]:
        image = random_image(encoding, 4, 6)
        if encoding in LOANS:
            with publisher.loan(4, 6, encoding, Header(frame_id=encoding)) as loan:
                loan.image[:] = image
        else:
            publisher.publish(image, Header(frame_id=encoding))
            assert (publisher._topics.compressed is not None) == (encoding in WITH_FORM)
        sent.append(image)
        spin_until(node, lambda encoding=encoding: is_received(encoding))
    for transport in ('raw', 'auto', 'shm'):
        frames = [frame for frame in received[transport] if frame.frame_id != 'first']
        for frame, image in zip(frames, sent, strict=True):
            np.testing.assert_array_equal(frame.raw, image)
    for subscriber in subscribers:
        subscriber.destroy()
    publisher.destroy()


def test_reason_for_a_reader_of_the_compressed_form(
        node: Node, camera: Node, capfd: pytest.CaptureFixture[str]) -> None:
    publisher = FramePublisher(camera, 'depth')
    subscriber = FrameSubscriber(node, '/front/depth', pytest.fail, transport='compressed')
    spin_until(node, lambda: publisher._topics.count_compressed() == 1)
    for _ in range(3):
        publisher.publish(np.ones((4, 6), np.float32))
    spin_until(node, lambda: not node.count_publishers('/front/depth/compressed'))
    assert subscriber._subscription.explain_no_frames() == (
        'no publisher of sensor_msgs/msg/CompressedImage on /front/depth/compressed, but one of '
        'sensor_msgs/msg/Image on /front/depth (node /front/camera); set transport:=raw or '
        'transport:=auto')
    assert capfd.readouterr().err.count(
        '/front/depth/compressed is not published: 32FC1 images have no JPEG and no PNG; receive '
        '/front/depth') == 1
    subscriber.destroy()
    publisher.destroy()


def test_image_that_is_too_long_for_its_codec(
        node: Node, capfd: pytest.CaptureFixture[str]) -> None:
    publisher = FramePublisher(node, 'long')
    messages: list[CompressedImage] = []
    node.create_subscription(CompressedImage, 'long/compressed', messages.append, 10)
    spin_until(node, lambda: publisher._topics.count_compressed() == 1)
    publisher.publish(np.zeros((1, 65_501), np.uint8))
    publisher.publish(np.zeros((4, 6), np.uint8))
    spin_until(node, lambda: bool(messages))
    assert 'no frame on /long/compressed: ' in capfd.readouterr().err
    publisher.destroy()
