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

"""The loop that publishes the frames of a source, its answers to requests, and its log."""

from __future__ import annotations

from dataclasses import replace
import math
import time
from typing import Any

from opencv_tools.base.logs import Log, log_if_slow
from opencv_tools.base.progress import Progress
from opencv_tools.capture.bag import BagSource
from opencv_tools.capture.errors import BrokenFrameError, CaptureError, UnavailableError
from opencv_tools.capture.frame import CapturedFrame, Source
from opencv_tools.capture.grabber import Grabber
from opencv_tools.capture.output_image import (
    check_conversion, describe_reduction, OutputImage)
from opencv_tools.capture.player import published_rate
from opencv_tools.capture.source import describe_opening, open_source
from opencv_tools.capture.v4l2.camera import CameraSource
from opencv_tools.image.errors import ConversionError, ImageError
from opencv_tools.nodes.parameters import with_values
from opencv_tools.nodes.publisher.camera_controls import CameraControls
from opencv_tools.nodes.publisher.delay import Delay
from opencv_tools.nodes.publisher.diagnostics import Diagnostics, SourceStatus
from opencv_tools.nodes.publisher.image_topics import ImageTopics
from opencv_tools.nodes.publisher.parameters import PublisherSettings
from opencv_tools.nodes.publisher.stamps import FrameHeaders
from opencv_tools.nodes.publisher.topic_player import differences, TopicPlayer
from opencv_tools.nodes.run_node import EXIT_FAILURE, EXIT_OK
from opencv_tools.nodes.video_settings import check_video
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.frame_topics import describe_partly_sent
from rclpy.node import Node
from std_srvs.srv import SetBool


class SourceLog:
    """Log the events of a source, in the thread that reads it; see `SourceListener`."""

    def __init__(self, log: Log, topic: str, controls: CameraControls) -> None:
        """
        Wait for the first event.

        :param topic: topic of the frames after remapping.
        :param controls: controls of the camera, which become parameters when it is open.
        """
        #: Number of frames that could not be read or published.
        self.dropped = 0
        self._log = log
        self._topic = topic
        self._controls = controls

    def opened(self, source: Source, is_back: bool) -> None:
        """Log the opened source and any camera settings that could not be applied."""
        if not is_back:
            self._log.info(f'{source.name} opened: {source.description}, '
                           f'publishing to {self._topic}')
        for warning in source.warnings:
            self._log.warning(warning)
        if isinstance(source, CameraSource):
            self._controls.camera_opened()

    def lost(self, reason: UnavailableError, longest: float) -> None:
        """Log that the source is unavailable."""
        limit = '' if longest == math.inf else f' for {longest:g} s'
        self._log.error(f'{reason}; waiting for it{limit}')
        self._controls.report_unused()

    def returned(self, source: Source, seconds: float) -> None:
        """Log that the source is available again."""
        self._log.info(f'{source.name} is back after {seconds:.1f} s: {source.description}')

    def broken(self, reason: BrokenFrameError | ImageError) -> None:
        """Count and log a frame that cannot be read or published."""
        self.dropped += reason.frames if isinstance(reason, BrokenFrameError) else 1
        # A camera may send the same broken frame repeatedly.
        self._log.warning(f'frame dropped: {reason}', every=1.0)

    def waiting(self, seconds: float) -> None:
        """Log that the next frame of a file is far away."""
        self._log.info(f'the next image is due in {seconds:.0f} s')


# Parameters that apply when the camera is opened.
_CAMERA_PARAMETERS = frozenset(('width', 'height', 'fps', 'fourcc'))
_RELEASE_SECONDS = 5
# Changes within this time, such as width and height, reopen the camera only once.
_CHANGE_SECONDS = 0.2


class PublishLoop:
    """
    Publish the frames of a source.

    ``run`` has a thread of its own. The executor of the node calls the other methods.
    """

    def __init__(
        self, node: Node, settings: PublisherSettings, topics: ImageTopics,
        controls: CameraControls,
    ) -> None:
        """
        Create a loop that has not opened its source yet.

        :param settings: values of the parameters; ``apply_changes`` replaces them.
        """
        self.settings = settings
        self._node = node
        self._context = node.context
        self._topic_player: TopicPlayer | None = None
        self._log = Log(node.get_logger())
        self._topics = topics
        self._controls = controls
        self._opened_encoding = ''  # the encoding that the source was opened for
        self._headers = FrameHeaders(node, settings.clock)
        self._events = SourceLog(self._log, topics.images.topic_name, controls)
        self._progress = Progress(self._log.info, 'Publishing video frame')
        self._grabber = Grabber(
            self._open_source, settings.capture, self._events, topics)
        self._is_live = False  # until the source is open
        self._unseen = 0  # frames without subscribers
        self._unfit = 0  # frames that were not sent in a form that has subscribers
        self._keyless = 0  # frames before the key frame that their subscribers wait for
        self._captured = ''  # encoding of the frames of a file; a camera has several
        self._reopening = Delay(node, _CHANGE_SECONDS, self._grabber.reopen)
        self._diagnostics = Diagnostics(node, self._source_status)

    @property
    def camera(self) -> CameraSource | None:
        """Camera that is open now."""
        source = self._grabber.source
        return source if isinstance(source, CameraSource) else None

    def run(self) -> int:
        """
        Publish frames until the source ends or ``stop`` is called.

        :returns: the exit status.
        """
        status = EXIT_OK
        try:
            try:
                for frame in self._grabber.frames():
                    if not self._is_live:  # a file can wait, but a camera cannot
                        self._topics.backlog.wait_for_room()
                    if self._topic_player and frame and frame.recorded:
                        self._topic_player.advance(frame.recorded)
                    self._publish(frame)
                    del frame  # otherwise a camera that is reopened would be in use
                    if self.settings.max_frames == self._progress.count > 0:
                        break
                if not (self._grabber.stopped or self._progress.count):
                    raise CaptureError(
                        f'{self.settings.shown_source}: no frame could be published')
            except CaptureError as err:
                self._log.error(str(err))
                self._controls.report_unused()
                status = EXIT_FAILURE
            if not self._grabber.stopped:
                if not self._topics.backlog.confirm_all(
                        [topics.frames.shared for topics in self._topics.outputs]):
                    status = EXIT_FAILURE
                if self._topic_player and status == EXIT_OK:
                    self._topic_player.finish()
        except RuntimeError:
            if self._context.ok():
                raise  # otherwise ROS was shut down before the next frame
        return status

    def stop(self) -> None:
        """End ``run`` before the next frame."""
        self._grabber.stop()
        self._topics.backlog.stop()
        if self._topic_player:
            self._topic_player.close()

    def summary(self) -> str:
        """Return the numbers of published and lost frames as a sentence."""
        missed = f', {self._grabber.missed} missed' if self._grabber.missed else ''
        unseen = f', {self._unseen} without subscribers' if self._unseen else ''
        may_wait = not (self._is_live or self.settings.wait_for_subscribers)
        if may_wait and self._unseen:
            unseen += ' (wait_for_subscribers:=1 waits for the first one)'
        unfit = (f', {self._unfit} in no form that its subscribers receive' if self._unfit else '')
        if self._keyless:
            unfit += f', {self._keyless} waiting for a key frame of the source'
        sent = self._progress.count - self._unseen - self._unfit - self._keyless
        partly = ''.join(describe_partly_sent(topics.frames.sent, sent)
                         for topics in self._topics.outputs)
        others = (f'; {self._topic_player.count} messages of other topics'
                  if self._topic_player else '')
        return (f'Published {self._progress.count} frames at '
                f'{self._progress.average_rate():.1f} Hz, {self._events.dropped} dropped'
                f'{missed}{unseen}{unfit}{partly}{others}')

    def check_changes(self, changes: dict[str, Any]) -> None:
        """
        Check changed parameters against the other ones.

        :param changes: new values by name.
        :raises ParameterError: the video cannot have these settings, or the frames of a file
            cannot have this encoding.
        """
        changed = with_values(self.settings, changes)
        if changed.video != self.settings.video:
            sizes = [topics.frames.video.stream.size for topics in self._topics.outputs
                     if topics.frames.video]
            check_video(changed.video, next(filter(None, sizes), None))
        if self._captured and 'encoding' in changes:
            try:
                check_conversion(self._captured, changes['encoding'])
            except ConversionError as err:
                raise ParameterError(f"parameter encoding is {changes['encoding']!r}: {err}; give "
                                     "'' for the encoding of the source") from err

    def apply_changes(self, changes: dict[str, Any]) -> None:
        """
        Apply changed parameters.

        :param changes: new values by name.
        """
        self.settings = with_values(self.settings, changes)
        self._grabber.use(self.settings.capture)
        if 'encoding' in changes:  # not every format of a camera converts to it
            self._grabber.reopen()
        elif _CAMERA_PARAMETERS & changes.keys():
            self._reopening.request()

    def set_capture(
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
                                f'{self.settings.shown_source} is still in use')
        self._log.info(response.message)
        return response

    def _publish(self, frame: CapturedFrame | None) -> None:
        """Publish one frame; None means a frame without a subscriber."""
        try:
            self._topics.rectify(self.settings.rectify)  # here, in the thread that publishes
        except ParameterError as err:
            self._log.error(str(err))
        if frame is None:
            self._count_unsent()
            return
        self._captured = '' if self._is_live else frame.encoding
        source, capture = self._grabber.source, self.settings.capture
        self._topics.use_video(
            self.settings.video, published_rate(capture.publish_rate, source) if source else 0.0)
        output = OutputImage(frame, capture)
        stamp, frame_id = self._headers.header(frame, self.settings)
        try:
            is_published = self._topics.publish(
                output, stamp, frame_id, is_live=self._is_live)
            if self.camera and self._topics.needs_key_frame:
                self.camera.request_key_frame()
            if not is_published:
                if frame.is_due:
                    self._count_unsent()
                return
            description = output.description
            reduction = describe_reduction(frame.encoding, self.settings.capture.encoding)
            if reduction:
                self._log.warning(
                    f'{reduction}, as the parameter encoding has it; an empty encoding '
                    'publishes them as they are', once='encoding')
        except BrokenFrameError as err:
            self._events.broken(err)
            return
        except ImageError as err:
            # A camera that was opened for another encoding will be reopened.
            if not self._is_live or self.settings.capture.encoding == self._opened_encoding:
                remedy = ('; an empty encoding publishes frames as they are' if (
                    isinstance(err, ConversionError) and self.settings.capture.encoding) else '')
                self._events.broken(ImageError(f'{err}{remedy}'))
            return
        self._diagnostics.count(max(0, time.monotonic_ns() - frame.stamp_ns) / 1e9)
        self._progress.tick(
            description, dropped=self._events.dropped, missed=self._grabber.missed)

    def _count_unsent(self) -> None:
        is_wanted = self._topics.has_subscribers(of_frames=True)
        needs_key = is_wanted and self._topics.needs_key_frame
        self._keyless += needs_key
        self._unfit += is_wanted and not needs_key
        self._unseen += not is_wanted
        self._progress.tick(
            'no subscribers' if not is_wanted else
            'waiting for a key frame of the source' if needs_key else
            'not in a form with subscribers',
            dropped=self._events.dropped, missed=self._grabber.missed)
        self._diagnostics.count()

    def _open_source(self) -> Source:
        settings, capture = self.settings, self.settings.capture
        self._opened_encoding = capture.encoding
        with log_if_slow(self._log, describe_opening(settings.source)):
            source = open_source(
                settings.source, replace(capture, controls=self._controls.requested),
                capture.read_timeout, settings.bag_topic)
        self._is_live = source.live
        if isinstance(source, BagSource) and settings.topics and not self._topic_player:
            self._topic_player = TopicPlayer(
                self._node, source, settings.topics.split(), self._log,
                from_start=not capture.start_frame)
            for difference in differences(capture.publish_rate, settings.stamp):
                self._log.warning(difference)
        return source

    def _source_status(self) -> SourceStatus:
        source = self._grabber.source
        return SourceStatus(
            source=self.settings.shown_source, description=source.description if source else '',
            unavailable_reason=self._grabber.outage.reason, paused=self._grabber.paused,
            missed=self._grabber.missed, dropped=self._events.dropped,
            reconnects=self._grabber.outage.count, awaited=self._topics.awaited)
