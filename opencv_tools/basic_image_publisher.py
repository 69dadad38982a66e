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

"""Node ``image_publisher``: publishes frames of a camera, file or pattern as image messages."""

from __future__ import annotations

from collections.abc import Sequence
import sys
from threading import Thread

from opencv_tools.base.logs import Log
from opencv_tools.capture.source import is_camera
from opencv_tools.nodes.declaration import declare_settings, watch_parameters
from opencv_tools.nodes.executable import Executable
from opencv_tools.nodes.publisher.camera_controls import CameraControls
from opencv_tools.nodes.publisher.camera_info import create_camera_info_service, open_calibration
from opencv_tools.nodes.publisher.image_topics import ImageTopics
from opencv_tools.nodes.publisher.loop import PublishLoop
from opencv_tools.nodes.publisher.parameters import PARAMETERS, PublisherSettings
from opencv_tools.nodes.run_node import ClosableNode, EXIT_FAILURE, run
from opencv_tools.transport.fastdds.profile import FastDdsSetup, NOT_CONFIGURED
from opencv_tools.transport.scheduling import use_priority
from std_srvs.srv import SetBool

_STOP_SECONDS = 5


class ImagePublisher(ClosableNode):
    """Publish the frames of a source on ``video_frames``, in a thread."""

    def __init__(self, fastdds: FastDdsSetup = NOT_CONFIGURED) -> None:
        """
        Start opening the source and publishing.

        :raises ParameterError: the value of a parameter is invalid.
        """
        super().__init__('image_publisher', automatically_declare_parameters_from_overrides=True)
        self._log = Log(self.get_logger())
        settings = declare_settings(self, PublisherSettings)
        settings.check()
        calibration = open_calibration(self, settings)
        self._topics = topics = ImageTopics(
            self, 'video_frames', calibration, fastdds, settings.wait_for_subscribers,
            settings.video)
        topics.rectify(settings.rectify)
        self.publisher_ = topics.images
        controls = CameraControls(self, PARAMETERS, lambda: self._loop.camera)
        self._loop = PublishLoop(self, settings, topics, controls)
        self._thread = Thread(target=self._publish, name='publishing', daemon=True)
        watch_parameters(
            self, PARAMETERS, self._loop.apply_changes, lambda: controls.parameters,
            self._loop.check_changes)
        for name in ('set_capture', '~/set_capture'):  # the second one is only of this node
            self.create_service(SetBool, name, self._loop.set_capture)
        create_camera_info_service(self, calibration, lambda: self._loop.settings)
        if not is_camera(settings.source):
            controls.warn_unknown_parameters()
        if settings.wait_for_subscribers:
            self._log.info(f'Waiting for {settings.wait_for_subscribers} subscriber(s) of images '
                           'or video')
        self._thread.start()

    def close(self) -> int:
        """
        Stop publishing, close the source and log a summary.

        :returns: the exit status.
        """
        self._loop.stop()
        self._thread.join(_STOP_SECONDS)
        self._topics.close()
        self._log.info(self._loop.summary())
        return super().close()

    def _publish(self) -> None:
        status = EXIT_FAILURE
        use_priority(self._loop.settings.priority)
        try:
            status = self._loop.run()
        finally:
            self.done.set_result(status)


#: What ``--help`` shows.
EXECUTABLE = Executable(
    name='img_publisher', node='image_publisher', settings=PublisherSettings,
    description='Publish frames as sensor_msgs/Image on video_frames.',
    example='-p source:=clip.mp4 -p publish_rate:=0')


def main(args: Sequence[str] | None = None) -> int:
    """
    Run the node.

    :param args: command line, program name first; None for the command line of the process.
    :returns: 0 on success, 1 if the source failed, 2 for invalid parameters or arguments.
    """
    return run(EXECUTABLE, ImagePublisher, args, failures=())


if __name__ == '__main__':
    sys.exit(main())
