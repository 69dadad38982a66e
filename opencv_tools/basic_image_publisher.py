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
from dataclasses import replace
import math
import sys
from threading import Thread
import time
from typing import Any

from opencv_tools.capture.frame import (
    BrokenFrameError, CaptureError, Frame, Source, UnavailableError)
from opencv_tools.capture.grabber import Grabber
from opencv_tools.capture.output_image import OutputImage
from opencv_tools.capture.source import is_camera, open_source
from opencv_tools.capture.v4l2.camera import CameraSource
from opencv_tools.image.errors import ImageError
from opencv_tools.image.text import MAX_PATH, printable, without_password
from opencv_tools.ros.fastdds.profile import FastDdsSetup, NOT_CONFIGURED
from opencv_tools.ros.parameters import declare_parameters, watch_parameters
from opencv_tools.ros.progress import Progress
from opencv_tools.ros.publisher.calibration_file import CameraInfoError
from opencv_tools.ros.publisher.camera_controls import CameraControls
from opencv_tools.ros.publisher.camera_info import Calibration
from opencv_tools.ros.publisher.diagnostics import Diagnostics, SourceStatus
from opencv_tools.ros.publisher.frame_size import expected_frame_bytes
from opencv_tools.ros.publisher.image_topics import FrameTopics
from opencv_tools.ros.publisher.parameters import (
    ENCODING, PARAMETERS, PublisherSettings, REOPEN_ON_CHANGE,
)
from opencv_tools.ros.publisher.stamps import Stamper
from opencv_tools.ros.run_node import Executable, EXIT_FAILURE, EXIT_OK, keep_exit_status, run
from opencv_tools.ros.timers import Delay
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import SetBool

_STOP_SECONDS = 5
_RELEASE_SECONDS = 5
# Changes within this time, such as width and height, reopen the camera only once.
_CHANGE_SECONDS = 0.2


class ImagePublisher(Node):
    """Publish the frames of a source on ``video_frames``, in a thread."""

    def __init__(self, fastdds: FastDdsSetup = NOT_CONFIGURED) -> None:
        """
        Start opening the source and publishing.

        :param fastdds: result of the configuration of Fast DDS.
        :raises ParameterError: the value of a parameter is invalid.
        """
        super().__init__('image_publisher', automatically_declare_parameters_from_overrides=True)
        self._settings = PublisherSettings(**declare_parameters(self, PARAMETERS))
        self.done = Future()
        self._dropped = 0
        self._last_drop = ''
        self._opened_encoding = ''  # the encoding that the source was opened for
        self._stamper = Stamper(self.get_clock())
        self._progress = Progress(self.get_logger().info, 'Publishing video frame')
        self._topics = FrameTopics(self, 'video_frames', self._open_calibration(), fastdds,
                                   self._settings.wait_for_subscribers)
        self.publisher_ = self._topics.images
        self._grabber = Grabber(self._open_source, self._settings.playback(),
                                self._settings.reconnect_policy(), self, self._topics)
        self._controls = CameraControls(self, PARAMETERS, self._camera)
        self._camera_opened = self.create_guard_condition(self._declare_controls)
        self._diagnostics = Diagnostics(self, self._source_status)
        self._reopening = Delay(self, _CHANGE_SECONDS, self._grabber.reopen)
        watch_parameters(self, PARAMETERS, self._apply_changes, lambda: self._controls.parameters)
        self.create_service(SetBool, 'set_capture', self._set_capture)
        self.create_service(SetCameraInfo, 'set_camera_info', self._set_camera_info)
        if not is_camera(self._settings.source):
            self._controls.warn_unknown_parameters()
        if self._settings.wait_for_subscribers:
            self.get_logger().info(
                f'Waiting for {self._settings.wait_for_subscribers} subscriber(s)')
        self._thread = Thread(target=self._publish_all, name='publishing', daemon=True)
        self._thread.start()

    def close(self) -> int:
        """
        Stop publishing, close the source and log a summary.

        :returns: the exit status.
        """
        self._grabber.stop()
        self._thread.join(_STOP_SECONDS)
        self.get_logger().info(
            f'Published {self._progress.count} frames at {self._progress.average_rate():.1f} Hz, '
            f'{self._dropped} dropped'
            + (f', {self._grabber.missed} missed' if self._grabber.missed else ''))
        return self.done.result() if self.done.done() else EXIT_OK

    def opened(self, source: Source) -> None:
        """Log the opened source and any camera settings that could not be applied."""
        if not self._grabber.unavailable_reason:
            self.get_logger().info(f'{source.name} opened: {source.description}, '
                                   f'publishing to {self.publisher_.topic_name}')
        if isinstance(source, CameraSource):
            for warning in source.warnings:
                self.get_logger().warning(warning)
            self._camera_opened.trigger()

    def lost(self, reason: UnavailableError) -> None:
        """Log that the source is unavailable."""
        seconds = self._grabber.reconnect.reconnect_timeout
        limit = '' if seconds == math.inf else f' for {seconds:g} s'
        self.get_logger().error(f'{reason}; waiting for it{limit}')
        self._controls.report_unused()

    def returned(self, source: Source, seconds: float) -> None:
        """Log that the source is available again."""
        self.get_logger().info(f'{source.name} is back after {seconds:.1f} s: '
                               f'{source.description}')

    def broken(self, reason: BrokenFrameError) -> None:
        """Log a frame that cannot be read."""
        self._drop(reason)

    def _publish_all(self) -> None:
        """Publish frames until the source ends, then set the exit status."""
        status = EXIT_FAILURE
        try:
            for frame in self._grabber.frames():
                if not self._is_live():  # a file can wait, but a camera cannot
                    self._topics.backlog.wait_for_room(lambda: self._grabber.stopped)
                self._publish(frame)
                if self._settings.max_frames == self._progress.count > 0:
                    break
            if not self._grabber.stopped:
                self._finish()
            status = EXIT_OK
        except CaptureError as err:
            self.get_logger().error(str(err))
            self._controls.report_unused()
        except RuntimeError:
            if self.context.ok():
                raise
            status = EXIT_OK  # ROS was shut down before the next frame
        finally:
            self.done.set_result(status)

    def _publish(self, frame: Frame | None) -> None:
        """Publish one frame; None means a frame without a subscriber."""
        if frame is None:
            self._count_unseen()
            return
        output = OutputImage(frame, self._settings.output())
        stamp = self._stamper.stamp(
            frame.stamp_ns, self._settings.stamp, self._settings.stamp_offset)
        try:
            if not self._topics.publish(output, stamp, self._settings.frame_id):
                self._count_unseen()
                return
            width, height = output.size
        except ImageError as err:
            # A camera that was opened for another encoding will be reopened.
            if not self._is_live() or self._settings.encoding == self._opened_encoding:
                self._drop(err)
            return
        self._diagnostics.count(max(0, time.monotonic_ns() - frame.stamp_ns) / 1e9)
        self._progress.tick(
            f'{width}x{height} {output.encoding}', self._dropped, self._grabber.missed)

    def _count_unseen(self) -> None:
        self._progress.tick('no subscribers', self._dropped, self._grabber.missed)
        self._diagnostics.count()

    def _drop(self, err: Exception) -> None:
        """Count and log a frame that cannot be published."""
        self._dropped += 1
        text = f'frame dropped: {err}'
        if text == self._last_drop:  # a camera may send the same broken frame repeatedly
            self.get_logger().warning(text, throttle_duration_sec=1.0)
        else:
            self.get_logger().warning(text)
        self._last_drop = text

    def _finish(self) -> None:
        """
        Wait until subscribers have received the published frames.

        :raises CaptureError: no frame was published.
        """
        if not self._progress.count:
            raise CaptureError(f'{self._source_name()}: no frame could be published')
        self._topics.backlog.wait_for_all(lambda: self._grabber.stopped)

    def _open_source(self) -> Source:
        self._opened_encoding = self._settings.encoding
        return open_source(
            self._settings.source, self._settings.camera_request(self._controls.requested),
            self._settings.read_timeout)

    def _source_name(self) -> str:
        """Return the name of the source without passwords."""
        return without_password(self._settings.source)

    def _is_live(self) -> bool:
        source = self._grabber.source
        return source is not None and source.live

    def _camera(self) -> CameraSource | None:
        source = self._grabber.source
        return source if isinstance(source, CameraSource) else None

    def _declare_controls(self) -> None:
        camera = self._camera()
        if camera:
            self._controls.declare(camera)

    def _open_calibration(self) -> Calibration:
        name = self._settings.camera_name or self.get_namespace().strip('/').replace('/', '_')
        return Calibration(
            self._settings.camera_info_url, name or 'camera',
            lambda text: self.get_logger().warning(printable(text, MAX_PATH)))

    def _apply_changes(self, changes: dict[str, Any]) -> None:
        """Apply changed parameters."""
        self._settings = replace(self._settings, **changes)
        self._grabber.playback = self._settings.playback()
        self._grabber.reconnect = self._settings.reconnect_policy()
        if ENCODING in changes:
            self._grabber.reopen()
        elif REOPEN_ON_CHANGE & changes.keys():
            self._reopening.request()

    def _set_capture(
        self, request: SetBool.Request, response: SetBool.Response,
    ) -> SetBool.Response:
        """Pause capturing and close the camera, or resume."""
        response.success = True
        if request.data:
            self._grabber.resume()
            response.message = 'capturing'
        else:
            response.success = self._grabber.pause(_RELEASE_SECONDS)
            response.message = ('paused' if response.success else
                                f'{self._source_name()} is still in use')
        self.get_logger().info(response.message)
        return response

    def _set_camera_info(
        self, request: SetCameraInfo.Request, response: SetCameraInfo.Response,
    ) -> SetCameraInfo.Response:
        """Save a calibration and publish it from now on."""
        try:
            response.status_message = self._topics.calibration.save(
                request.camera_info, self._settings.flip, self._settings.rotate)
            response.success = True
        except CameraInfoError as err:
            response.status_message = str(err)
        self.get_logger().info(f'set_camera_info: {printable(response.status_message, MAX_PATH)}')
        return response

    def _source_status(self) -> SourceStatus:
        source = self._grabber.source
        return SourceStatus(
            self._source_name(), source.description if source else '',
            self._grabber.unavailable_reason, self._grabber.paused, self._grabber.missed,
            self._dropped, self._grabber.reconnects, self._topics.awaited)


def main(args: Sequence[str] | None = None) -> int:
    """
    Run the node.

    :param args: command line, program name first; None for the command line of the process.
    :returns: 0 on success, 1 if the source failed, 2 for invalid parameters or arguments.
    """
    executable = Executable(
        'img_publisher', 'image_publisher', 'Publish frames as sensor_msgs/Image on video_frames.',
        PARAMETERS, '-p source:=clip.mp4 -p publish_rate:=0', expected_frame_bytes)
    status = run(executable, ImagePublisher, args, failures=())
    keep_exit_status()
    return status


if __name__ == '__main__':
    sys.exit(main())
