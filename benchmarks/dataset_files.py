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

"""Bags of JPEGs and joints for the benchmark of data sets, from the frames of the test clip."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from opencv_tools.bags.schemas import COMPRESSED_IMAGE
from opencv_tools.bags.writing import BagChannel, BagWriter
from opencv_tools.base.units import NANO
from opencv_tools.image.cdr import compressed_image_to_cdr, WireCompressedImage, WireHeader
from opencv_tools.message_types.codec import MessageCodec
from opencv_tools.message_types.definition import read_definition

CLIP = Path(__file__).resolve().parent.parent / 'test/data/big_buck_bunny_720p.mp4'
#: Topic of each camera.
CAMERAS = {'front': '/front/image_raw/compressed', 'wrist': '/wrist/image_raw/compressed'}
FPS = 30
_BEGAN = 1_700_000_000 * NANO
_JOINTS = ('shoulder', 'elbow', 'wrist')
_JOINT_RATE = 100
_DELAY_NS = 5_000_000  # from the stamp to the time of the recording


def write_jpegs(folder: Path) -> int:
    """Write the frames of the clip as JPEGs, forwards and backwards; return their mean size."""
    folder.mkdir()
    capture = cv2.VideoCapture(str(CLIP), cv2.CAP_FFMPEG)
    contents = []
    while (frame := capture.read())[0]:
        contents.append(cv2.imencode('.jpg', frame[1])[1].tobytes())
    contents += contents[-2:0:-1]  # without a cut at the begin of the next round
    for number, content in enumerate(contents):
        (folder / f'{number:06d}.jpg').write_bytes(content)
    return sum(map(len, contents)) // len(contents)


def write_bag(path: Path, jpegs: Path, count: int) -> int:
    """
    Write a bag with two cameras and joints, as a recorder would.

    :param jpegs: folder that ``write_jpegs`` has written.
    :param count: number of pictures of each camera.
    :returns: size of the bag in bytes.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    definition = read_definition('sensor_msgs/msg/JointState')
    codec = MessageCodec(definition)
    joints = BagChannel(topic='/joint_states', type_name=definition.name,
                        definition=definition.text)
    channels = [BagChannel(topic=topic, type_name=COMPRESSED_IMAGE) for topic in CAMERAS.values()]
    paths = sorted(jpegs.iterdir())
    writer = BagWriter(path)
    steps = 0
    for number in range(count):
        time_ns = _BEGAN + number * NANO // FPS
        while _BEGAN + steps * NANO // _JOINT_RATE <= time_ns:
            _write_joints(writer, joints, codec, _BEGAN + steps * NANO // _JOINT_RATE)
            steps += 1
        message = compressed_image_to_cdr(WireCompressedImage(
            header=WireHeader(*divmod(time_ns, NANO), 'camera'), format='jpeg',
            data=paths[number % len(paths)].read_bytes()))
        for channel in channels:
            writer.write(channel, [message], log_ns=time_ns + _DELAY_NS, publish_ns=time_ns)
    writer.close()
    return path.stat().st_size


def _write_joints(writer: BagWriter, channel: BagChannel, codec: MessageCodec, time_ns: int,
                  ) -> None:
    seconds, nanoseconds = divmod(time_ns, NANO)
    position = np.sin((time_ns - _BEGAN) / NANO + np.arange(len(_JOINTS)))
    data = codec.write({'header': {'stamp': {'sec': seconds, 'nanosec': nanoseconds}},
                        'name': [*_JOINTS], 'position': position})
    writer.write(channel, [data], log_ns=time_ns + _DELAY_NS, publish_ns=time_ns)
