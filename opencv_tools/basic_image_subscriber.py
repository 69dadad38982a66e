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

"""The node ``image_subscriber``: image messages, as files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import sys
from typing import TypedDict

from opencv_tools.cv_bridge import CvBridge, CvBridgeError
from opencv_tools.image.cdr import CdrError
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.recorder import Recorder, RecordingError
from opencv_tools.recording.writers import check_format
from opencv_tools.ros.messages import read_image
from opencv_tools.ros.parameters import declare_parameters, Parameter
from opencv_tools.ros.progress import Progress
from opencv_tools.ros.qos import best_effort_qos, reliable_qos
from opencv_tools.ros.runtime import DONE, FAILED, Program, run
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.task import Future
from sensor_msgs.msg import Image


def _check_file_name(template: str) -> None:
    check_format(FileNames(template).suffix)


def _check_folder(text: str) -> None:
    if not text:
        raise ValueError('name a folder')


PARAMETERS = (
    Parameter('output_dir', 'frames', 'folder to write to, made when missing',
              check=_check_folder, fixed=True),
    Parameter('file_name', '{seq:06d}.png', 'names of the files; the extension is the format',
              check=_check_file_name, fixed=True),
    Parameter('max_frames', 0, 'end after so many frames; 0 for no end', maximum=10**9,
              fixed=True),
    Parameter('timeout', 0.0, 'give up after so many seconds without a frame; 0 to wait for ever',
              maximum=1e9, fixed=True),
)


class MessageInfo(TypedDict):
    """What rclpy tells of a message, as far as it is used here."""

    publication_sequence_number: int | None


class ImageSubscriber(Node):
    """Receive ``video_frames`` and write each frame to a file."""

    def __init__(self) -> None:
        """
        Make the folder ready and subscribe.

        :raises ParameterError: a parameter's value cannot be used.
        :raises RecordingError: the folder cannot be written to.
        """
        super().__init__('image_subscriber', automatically_declare_parameters_from_overrides=True)
        settings = declare_parameters(self, PARAMETERS)
        self.done = Future()
        self.br = CvBridge()
        self._folder = Path(settings['output_dir']).expanduser().absolute()
        self._max_frames = settings['max_frames']
        self._accepted = 0
        self._lost = 0
        self._last_number = 0
        self._refused = 0
        self._recorder = Recorder(
            self._folder, FileNames(settings['file_name']), self._report_failure)
        self._progress = Progress(self.get_logger().info, 'Receiving video frame')
        self.subscription = self._subscribe(reliable_qos())
        self._timeout = settings['timeout']
        self._timer = self.create_timer(
            self._timeout, self._give_up, clock=Clock(clock_type=ClockType.STEADY_TIME),
        ) if self._timeout else None
        self.get_logger().info(
            f'Waiting for {self.subscription.topic_name}, writing to {self._folder}')

    def listener_callback(self, data: bytes, info: MessageInfo) -> None:
        """
        Hand a frame over to be written.

        :param data: the message as it came over the wire; the frame is a view of it.
        :param info: what the middleware says of it, its number among them.
        """
        if self.done.done():
            return
        self._count_lost(info)
        if self._timer:
            self._timer.reset()
        try:
            image = read_image(data)
        except CdrError as err:
            self._refuse(err)
            return
        try:
            self._accepted += self._recorder.put(self.br.imgmsg_to_cv2(image), image.encoding)
        except CvBridgeError as err:
            self._refuse(err)
        self._progress.tick(
            f'{image.width}x{image.height} {image.encoding[:40]}', self._dropped())
        if self._max_frames and self._accepted == self._max_frames:
            self.done.set_result(DONE)

    def close(self) -> int:
        """
        Write what was received and say how it went.

        :returns: the exit status.
        """
        self._recorder.close()
        failed = self._recorder.failed + self._refused
        self.get_logger().info(
            f'Received {self._progress.count} frames at {self._progress.average_rate():.1f} Hz: '
            f'{self._recorder.written} written to {self._folder}, {self._dropped()} dropped, '
            f'{failed} failed')
        if failed:
            return FAILED
        return self.done.result() if self.done.done() else DONE

    def _subscribe(self, qos: QoSProfile) -> Subscription:
        return self.create_subscription(
            Image, 'video_frames', self.listener_callback, qos, raw=True,
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=self._accept_best_effort))

    def _accept_best_effort(self, _: QoSRequestedIncompatibleQoSInfo) -> None:
        """Ask for less, so that a publisher that offers no more is received too."""
        self.get_logger().info('A publisher offers best effort only; receiving best effort')
        self.destroy_subscription(self.subscription)
        self.subscription = self._subscribe(best_effort_qos())

    def _count_lost(self, info: MessageInfo) -> None:
        """Count the messages that were published since the last one but did not arrive."""
        number = info['publication_sequence_number'] or 0
        if self.subscription.get_publisher_count() != 1:
            number = 0  # the numbers of several publishers say nothing: each counts for itself
        if number and self._last_number:
            self._lost += max(0, number - self._last_number - 1)
        self._last_number = number

    def _dropped(self) -> int:
        return self._lost + self._recorder.dropped

    def _refuse(self, err: Exception) -> None:
        """Take note of a message that cannot be recorded."""
        self._refused += 1
        self._report_failure(f'message left out: {err}')

    def _report_failure(self, text: str) -> None:
        self.get_logger().error(text, throttle_duration_sec=1.0)

    def _give_up(self) -> None:
        """End because no frame came."""
        if not self.done.done():
            self.get_logger().error(
                f'no frame on {self.subscription.topic_name} within {self._timeout:g} s; '
                'is a publisher running, in the same ROS_DOMAIN_ID?')
            self.done.set_result(FAILED)


def main(args: Sequence[str] | None = None) -> int:
    """
    Run the node.

    :param args: the command line, program name first; None for the process's own.
    :returns: 0 when it ended as asked, 1 when frames or files failed, 2 for bad parameters.
    """
    program = Program(
        'img_subscriber', 'Write the frames on video_frames to files.', PARAMETERS)
    return run(program, ImageSubscriber, args, failures=(RecordingError,))


if __name__ == '__main__':
    sys.exit(main())
