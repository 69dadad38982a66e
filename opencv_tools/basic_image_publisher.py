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

"""The node ``image_publisher``: frames of a camera, a file or a pattern, as image messages."""

from __future__ import annotations

from collections.abc import Sequence
import sys
from threading import Event, Thread
import time

from opencv_tools.capture.frame import CaptureError, Frame, MAX_RATE
from opencv_tools.capture.player import ON_END, Player
from opencv_tools.capture.source import check_source, open_source
from opencv_tools.cv_bridge import CvBridge
from opencv_tools.image.color import convert
from opencv_tools.image.encodings import COLOR_ENCODINGS, find_encoding
from opencv_tools.image.errors import ConversionError
from opencv_tools.ros.parameters import declare_parameters, Parameter
from opencv_tools.ros.progress import Progress
from opencv_tools.ros.qos import create_frame_publisher
from opencv_tools.ros.runtime import DONE, FAILED, Program, run
from opencv_tools.ros.transport import transport_for_frames
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.task import Future
from rclpy.time import Time
from sensor_msgs.msg import Image
from std_msgs.msg import Header

PARAMETERS = (
    Parameter('source', '0', 'device number, device path, video file, picture file, folder or '
              'glob of pictures, stream URL, or pattern[:WIDTHxHEIGHT[@FPS]]', check=check_source),
    Parameter('publish_rate', 10.0, "frames per second; 0 for the source's own rate",
              maximum=MAX_RATE),
    Parameter('encoding', 'bgr8', "encoding of the messages; '' for the source's own",
              choices=(*COLOR_ENCODINGS, '')),
    Parameter('frame_id', 'camera', 'coordinate frame of the camera, for the header'),
    Parameter('on_end', 'stop', 'what follows the last frame of a file', choices=ON_END),
    Parameter('max_frames', 0, 'end after so many frames; 0 for no end', maximum=10**9),
    Parameter('wait_for_subscribers', 0, 'start only when so many subscribers are there',
              maximum=1000),
)

_POLL_SECONDS = 0.02
_SETTLE_SECONDS = 0.2
_ACKNOWLEDGE_SECONDS = 5
_STOP_SECONDS = 5


class ImagePublisher(Node):
    """Publish the frames of a source to ``video_frames``, on a thread of its own."""

    def __init__(self) -> None:
        """
        Open the source and start to publish.

        :raises ParameterError: a parameter's value cannot be used.
        :raises CaptureError: the source cannot be opened.
        """
        super().__init__('image_publisher', automatically_declare_parameters_from_overrides=True)
        settings = declare_parameters(self, PARAMETERS)
        self.done = Future()
        self.br = CvBridge()
        self._encoding = settings['encoding']
        self._frame_id = settings['frame_id']
        self._max_frames = settings['max_frames']
        self._wanted_subscribers = settings['wait_for_subscribers']
        self._source = open_source(settings['source'])
        self._stopped = Event()
        self._dropped = 0
        self._player = Player(self._source, settings['publish_rate'], settings['on_end'],
                              self._stopped, self._leave_out)
        self._progress = Progress(self.get_logger().info, 'Publishing video frame')
        self.publisher_ = create_frame_publisher(self, Image, 'video_frames')
        self.get_logger().info(
            f'{self._source.name} opened, publishing to {self.publisher_.topic_name}')
        self._thread = Thread(target=self._publish_all, name='publishing', daemon=True)
        self._thread.start()

    def close(self) -> int:
        """
        Stop publishing, let go of the source and say how many frames there were.

        :returns: the exit status.
        """
        self._stopped.set()
        self._thread.join(_STOP_SECONDS)
        if not self._thread.is_alive():
            self._source.close()
        self.get_logger().info(
            f'Published {self._progress.count} frames at {self._progress.average_rate():.1f} Hz, '
            f'{self._dropped} dropped')
        return self.done.result() if self.done.done() else DONE

    def _publish_all(self) -> None:
        """Publish frame after frame until the end, then tell the executor."""
        status = FAILED
        try:
            self._await_subscribers()
            for frame in self._player.frames():
                self._publish(frame)
                if self._max_frames and self._progress.count == self._max_frames:
                    break
            self._await_acknowledgement()
            status = DONE
        except CaptureError as err:
            self.get_logger().error(str(err))
        except RuntimeError:
            if self.context.ok():
                raise
            status = DONE  # ROS was shut down between two frames
        finally:
            self.done.set_result(status)

    def _publish(self, frame: Frame) -> None:
        """Publish one frame, stamped with the time of its capture."""
        now = self.get_clock().now().nanoseconds
        age = time.monotonic_ns() - frame.stamp_ns if frame.stamp_ns is not None else 0
        stamp = Time(nanoseconds=max(0, now - age))  # simulated time may be younger than a frame
        header = Header(stamp=stamp.to_msg(), frame_id=self._frame_id)
        image, encoding = frame.image, self._encoding or frame.encoding
        if encoding != frame.encoding:
            try:
                image = convert(image, find_encoding(frame.encoding), find_encoding(encoding))
            except ConversionError as err:
                self._leave_out(err)
                return
        self.publisher_.publish(self.br.cv2_to_cdr(image, encoding, header))
        self._progress.tick(image.shape[1], image.shape[0], encoding, self._dropped)

    def _leave_out(self, err: Exception) -> None:
        """Take note of a frame that cannot be published."""
        self._dropped += 1
        self.get_logger().warning(f'frame left out: {err}')

    def _await_subscribers(self) -> None:
        """Wait until enough subscribers are matched; a camera is kept running meanwhile."""
        if not self._wanted_subscribers:
            return
        self.get_logger().info(f'Waiting for {self._wanted_subscribers} subscriber(s)')
        settled_at = 0.0
        while not self._stopped.is_set():
            now = time.monotonic()
            if self.publisher_.get_subscription_count() < self._wanted_subscribers:
                settled_at = 0.0
            elif not settled_at:
                # The subscriber may take a moment longer to know this publisher.
                settled_at = now + _SETTLE_SECONDS
            elif now >= settled_at:
                return
            if not self._source.live:
                self._stopped.wait(_POLL_SECONDS)
            elif not self._source.skip():
                return

    def _await_acknowledgement(self) -> None:
        """Stay until reliable subscribers have every frame: what is not sent ends with us."""
        if self._stopped.is_set():
            return
        if not self._progress.count:
            raise CaptureError(f'{self._source.name}: no frame could be published')
        if not self.publisher_.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGE_SECONDS)):
            self.get_logger().warning(
                f'a subscriber did not confirm the last frames within {_ACKNOWLEDGE_SECONDS} s')


def main(args: Sequence[str] | None = None) -> int:
    """
    Run the node.

    :param args: the command line, program name first; None for the process's own.
    :returns: 0 when it ended as asked, 1 when the source failed, 2 for bad parameters.
    """
    program = Program(
        'img_publisher', 'Publish frames as sensor_msgs/Image on video_frames.', PARAMETERS)
    return run(program, _make_publisher, args, failures=(CaptureError,))


def _make_publisher() -> ImagePublisher:
    with transport_for_frames():
        return ImagePublisher()


if __name__ == '__main__':
    sys.exit(main())
