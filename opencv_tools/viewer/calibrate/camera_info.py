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

"""Calibrations of the camera of a topic, set in its node, in the executor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from opencv_tools.base.text import enumerated, printable
from opencv_tools.calibration.solve import Calibration
from opencv_tools.viewer.control import CameraControl, services_of
from opencv_tools.viewer.errors import MAX_MESSAGE, RequestError
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from sensor_msgs.srv import SetCameraInfo

_TYPE, _SERVICE = 'sensor_msgs/srv/SetCameraInfo', 'set_camera_info'
_RECTIFIED = 'image_rect'  # begin of the names of image_proc, as in tiles.js of the page
_MAX_NODES = 50


def check_raw(name: str) -> None:
    """
    Check that the images of a topic are not rectified by the name of the topic.

    A calibration of rectified images has nearly no distortion, and would replace that of the lens.

    :raises RequestError: they are.
    """
    if name.rpartition('/')[2].startswith(_RECTIFIED):
        raise RequestError('calibrate the raw images of the camera, because those of '
                           f'{printable(name)} are rectified already')


def camera_info_of(calibration: Calibration) -> CameraInfo:
    """Return the message of a calibration, without header."""
    width, height = calibration.size
    return CameraInfo(
        width=width, height=height, distortion_model=calibration.model,
        d=calibration.d.tolist(), k=calibration.k.ravel(), r=np.eye(3).ravel(),
        p=calibration.p.ravel())


async def set_camera_info(
    control: CameraControl, topic: str, nodes: Sequence[str], info: CameraInfo,
) -> dict[str, Any]:
    """
    Set the calibration of the camera of an image topic.

    :param nodes: full names of the nodes that publish it; no other node is called.
    :returns: name of the service, and its message.
    :raises RequestError: there is not one such service, or the node has refused.
    """
    service = find_service(control.node, topic, nodes)
    answer = await control.call(
        SetCameraInfo, service, SetCameraInfo.Request(camera_info=info))
    message = printable(answer.status_message, MAX_MESSAGE)
    if not answer.success:
        raise RequestError(f'{printable(service)} has refused the calibration: '
                           f'{message or "it gave no reason"}; download the file instead')
    return {'service': printable(service), 'message': message}


def find_service(node: Node, topic: str, nodes: Sequence[str]) -> str:
    """
    Return the name of the service that sets the calibration of an image topic.

    It is ``set_camera_info`` in the namespace of the topic, or the only service of this type.

    :param nodes: full names of the nodes that publish the topic.
    :raises RequestError: these nodes have no such service, or several.
    """
    found = {service for name in nodes[:_MAX_NODES]
             for service, types in services_of(node, name).items() if _TYPE in types}
    usual = f'{topic.rpartition("/")[0]}/{_SERVICE}'
    if usual in found or len(found) == 1:
        return usual if usual in found else found.pop()
    if found:
        raise RequestError('the camera has several services for calibrations, and none is '
                           f'{printable(usual)}: {enumerated(sorted(found))}; download the file')
    raise RequestError(f'no node that publishes {printable(topic)} has the service {_SERVICE}: '
                       'download the file and configure the camera with it')
