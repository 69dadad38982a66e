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
import math
import sys
from threading import Thread
import time
from typing import Any

from opencv_tools.capture.frame import (
    BrokenFrameError, CaptureError, Frame, Source, UnavailableError,
)
from opencv_tools.capture.grabber import Grabber
from opencv_tools.capture.rendition import OutputImage
from opencv_tools.capture.source import is_camera, open_source
from opencv_tools.capture.v4l2 import CameraSource
from opencv_tools.image.errors import ImageError
from opencv_tools.image.text import MAX_PATH, printable, without_password
from opencv_tools.ros.calibration_file import CameraInfoError
from opencv_tools.ros.camera_info import Calibration
from opencv_tools.ros.capture_parameters import (
    camera_request, ENCODING, OPENING, output_settings, PARAMETERS, playback_settings,
    reconnect_policy,
)
from opencv_tools.ros.controls import CameraControls
from opencv_tools.ros.diagnostics import Condition, Diagnostics
from opencv_tools.ros.frame_size import expected_frame_bytes
from opencv_tools.ros.frame_topics import FrameTopics
from opencv_tools.ros.parameters import declare_parameters, watch_parameters
from opencv_tools.ros.progress import Progress
from opencv_tools.ros.runtime import DONE, FAILED, keep_exit_status, Program, run
from opencv_tools.ros.stamps import Stamper
from opencv_tools.ros.timers import Delay
from opencv_tools.ros.transport import Transport, UNTOUCHED
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import SetBool

_STOP_SECONDS = 5
_RELEASE_SECONDS = 5
# What changes within this time, such as width and height, lets a camera be opened anew once.
_CHANGE_SECONDS = 0.2


class ImagePublisher(Node):
    """Publish the frames of a source to ``video_frames``, on a thread of its own."""

    def __init__(self, transport: Transport = UNTOUCHED) -> None:
        """
        Begin to open the source and to publish.

        :param transport: how frames go to subscribers on this machine.
        :raises ParameterError: a parameter's value cannot be used.
        """
        super().__init__('image_publisher', automatically_declare_parameters_from_overrides=True)
        self._settings = declare_parameters(self, PARAMETERS)
        self.done = Future()
        self._dropped = 0
        self._left_out = ''
        self._opened_for = ''  # the encoding
        self._stamper = Stamper(self.get_clock())
        self._progress = Progress(self.get_logger().info, 'Publishing video frame')
        self._topics = FrameTopics(self, 'video_frames', self._calibrate(), transport,
                                   self._settings['wait_for_subscribers'])
        self.publisher_ = self._topics.images
        self._grabber = Grabber(self._open_source, playback_settings(self._settings),
                                reconnect_policy(self._settings), self, self._topics)
        self._controls = CameraControls(self, PARAMETERS, self._camera)
        self._camera_opened = self.create_guard_condition(self._declare_controls)
        self._diagnostics = Diagnostics(self, self._condition)
        self._reopening = Delay(self, _CHANGE_SECONDS, self._grabber.reopen)
        watch_parameters(self, PARAMETERS, self._change, lambda: self._controls.parameters)
        self.create_service(SetBool, 'set_capture', self._set_capture)
        self.create_service(SetCameraInfo, 'set_camera_info', self._set_camera_info)
        if not is_camera(self._settings['source']):
            self._controls.refuse_the_rest()
        if self._settings['wait_for_subscribers']:
            self.get_logger().info(
                f'Waiting for {self._settings["wait_for_subscribers"]} subscriber(s)')
        self._thread = Thread(target=self._publish_all, name='publishing', daemon=True)
        self._thread.start()

    def close(self) -> int:
        """
        Stop publishing, let go of the source and say how many frames there were.

        :returns: the exit status.
        """
        self._grabber.stop()
        self._thread.join(_STOP_SECONDS)
        self.get_logger().info(
            f'Published {self._progress.count} frames at {self._progress.average_rate():.1f} Hz, '
            f'{self._dropped} dropped'
            + (f', {self._grabber.missed} missed' if self._grabber.missed else ''))
        return self.done.result() if self.done.done() else DONE

    def opened(self, source: Source) -> None:
        """Say what was opened, and what came of what was asked for."""
        if not self._grabber.unavailable_reason:
            self.get_logger().info(f'{source.name} opened: {source.description}, '
                                   f'publishing to {self.publisher_.topic_name}')
        if isinstance(source, CameraSource):
            for warning in source.warnings:
                self.get_logger().warning(warning)
            self._camera_opened.trigger()

    def lost(self, reason: UnavailableError) -> None:
        """Say that there is no source now."""
        seconds = self._grabber.reconnect.reconnect_timeout
        limit = '' if seconds == math.inf else f' for {seconds:g} s'
        self.get_logger().error(f'{reason}; waiting for it{limit}')
        self._controls.report_unused()

    def returned(self, source: Source, seconds: float) -> None:
        """Say that the source gives frames again."""
        self.get_logger().info(f'{source.name} is back after {seconds:.1f} s: '
                               f'{source.description}')

    def broken(self, reason: BrokenFrameError) -> None:
        """Take note of a frame that cannot be read."""
        self._leave_out(reason)

    def _publish_all(self) -> None:
        """Publish frame after frame until the end, then tell the executor."""
        status = FAILED
        try:
            for frame in self._grabber.frames():
                if not self._is_live():  # a file can wait, a camera cannot
                    self._topics.backlog.wait_for_room(lambda: self._grabber.stopped)
                self._publish(frame)
                if self._settings['max_frames'] == self._progress.count > 0:
                    break
            if not self._grabber.stopped:
                self._finish()
            status = DONE
        except CaptureError as err:
            self.get_logger().error(str(err))
            self._controls.report_unused()
        except RuntimeError:
            if self.context.ok():
                raise
            status = DONE  # ROS was shut down between two frames
        finally:
            self.done.set_result(status)

    def _publish(self, frame: Frame | None) -> None:
        """Publish one frame, None if nobody sees it."""
        if frame is None:
            self._note_no_subscriber()
            return
        output = OutputImage(frame, output_settings(self._settings))
        stamp = self._stamper.stamp(
            frame.stamp_ns, self._settings['stamp'], self._settings['stamp_offset'])
        try:
            if not self._topics.publish(output, stamp, self._settings['frame_id']):
                self._note_no_subscriber()
                return
            width, height = output.size
        except ImageError as err:
            # A camera that was opened for another encoding is about to be opened anew.
            if not self._is_live() or self._settings['encoding'] == self._opened_for:
                self._leave_out(err)
            return
        self._diagnostics.count(max(0, time.monotonic_ns() - frame.stamp_ns) / 1e9)
        self._progress.tick(
            f'{width}x{height} {output.encoding}', self._dropped, self._grabber.missed)

    def _note_no_subscriber(self) -> None:
        self._progress.tick('nobody subscribes', self._dropped, self._grabber.missed)
        self._diagnostics.count()

    def _leave_out(self, err: Exception) -> None:
        """Take note of a frame that cannot be published."""
        self._dropped += 1
        text = f'frame left out: {err}'
        if text == self._left_out:  # a camera may send the same again and again
            self.get_logger().warning(text, throttle_duration_sec=1.0)
        else:
            self.get_logger().warning(text)
        self._left_out = text

    def _finish(self) -> None:
        """
        Wait until subscribers have what was published.

        :raises CaptureError: nothing was.
        """
        if not self._progress.count:
            raise CaptureError(f'{self._source_name()}: no frame could be published')
        self._topics.backlog.wait_for_all(lambda: self._grabber.stopped)

    def _open_source(self) -> Source:
        self._opened_for = self._settings['encoding']
        return open_source(
            self._settings['source'], camera_request(self._settings, self._controls.wanted),
            self._settings['read_timeout'])

    def _source_name(self) -> str:
        """Write the source as it may be printed."""
        return without_password(self._settings['source'])

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

    def _calibrate(self) -> Calibration:
        name = self._settings['camera_name'] or self.get_namespace().strip('/').replace('/', '_')
        return Calibration(
            self._settings['camera_info_url'], name or 'camera',
            lambda text: self.get_logger().warning(printable(text, MAX_PATH)))

    def _change(self, changes: dict[str, Any]) -> None:
        """Go on with parameters that were changed."""
        self._settings = {**self._settings, **changes}
        self._grabber.playback = playback_settings(self._settings)
        self._grabber.reconnect = reconnect_policy(self._settings)
        if ENCODING in changes:
            self._grabber.reopen()
        elif OPENING & changes.keys():
            self._reopening.ask()

    def _set_capture(
        self, request: SetBool.Request, response: SetBool.Response,
    ) -> SetBool.Response:
        """Pause, letting go of a camera, or go on."""
        response.success = True
        if request.data:
            self._grabber.resume()
            response.message = 'capturing'
        else:
            response.success = self._grabber.pause(_RELEASE_SECONDS)
            response.message = ('paused' if response.success else
                                f'{self._source_name()} is still held')
        self.get_logger().info(response.message)
        return response

    def _set_camera_info(
        self, request: SetCameraInfo.Request, response: SetCameraInfo.Response,
    ) -> SetCameraInfo.Response:
        """Keep a calibration and publish it from now on."""
        try:
            response.status_message = self._topics.calibration.save(
                request.camera_info, self._settings['flip'], self._settings['rotate'])
            response.success = True
        except CameraInfoError as err:
            response.status_message = str(err)
        self.get_logger().info(f'set_camera_info: {printable(response.status_message, MAX_PATH)}')
        return response

    def _condition(self) -> Condition:
        source = self._grabber.source
        return Condition(
            self._source_name(), source.description if source else '',
            self._grabber.unavailable_reason, self._grabber.paused, self._grabber.missed,
            self._dropped, self._grabber.reconnects, self._topics.awaited)


def main(args: Sequence[str] | None = None) -> int:
    """
    Run the node.

    :param args: the command line, program name first; None for the process's own.
    :returns: 0 when it ended as asked, 1 when the source failed, 2 for bad parameters.
    """
    program = Program(
        'img_publisher', 'image_publisher', 'Publish frames as sensor_msgs/Image on video_frames.',
        PARAMETERS, '-p source:=clip.mp4 -p publish_rate:=0', expected_frame_bytes)
    status = run(program, ImagePublisher, args, failures=())
    keep_exit_status()
    return status


if __name__ == '__main__':
    sys.exit(main())
