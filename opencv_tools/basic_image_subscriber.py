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

"""Node ``image_subscriber``: records image messages as files."""

from __future__ import annotations

from collections.abc import Sequence
import sys
import time

from opencv_tools.base.logs import log_if_slow
from opencv_tools.base.progress import open_progress
from opencv_tools.cv_bridge import CvBridge, CvBridgeError
from opencv_tools.image.errors import ImageError
from opencv_tools.nodes.conversion import BagMessages, FrameConverter
from opencv_tools.nodes.declaration import declare_settings, warn_unknown_parameters
from opencv_tools.nodes.executable import Executable
from opencv_tools.nodes.run_node import ClosableNode, EXIT_FAILURE, EXIT_OK, run
from opencv_tools.nodes.subscriber.parameters import PARAMETERS, RecorderSettings
from opencv_tools.nodes.subscriber.session import SubscriberSession
from opencv_tools.nodes.subscriber.topic_recorder import TopicRecorder
from opencv_tools.recording.bag_sink import MessageFrame
from opencv_tools.recording.errors import FailureLog, RecordingError
from opencv_tools.topics.options import SubscriptionOptions
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.topics.subscription import Account, FrameSubscription
from opencv_tools.topics.timers import create_steady_timer
from opencv_tools.topics.topic_discovery import resolve_topic
from opencv_tools.transport.scheduling import use_priority

# Maximum time to record received frames at the end.
_END_SECONDS = 60.0
# Frames that stay in shared memory while they wait to be written; more are copied.
_MAX_VIEWS = 2


class ImageSubscriber(ClosableNode):
    """Receive ``video_frames`` and record each frame."""

    def __init__(self) -> None:
        """
        Open the output folder and subscribe.

        :raises ParameterError: the value of a parameter is invalid.
        :raises RecordingError: the output folder cannot be used.
        """
        super().__init__('image_subscriber', automatically_declare_parameters_from_overrides=True)
        settings = declare_settings(self, RecorderSettings)
        self.br = CvBridge()
        self._log, self._progress = open_progress(
            self.get_logger(), 'Receiving video frame', settings.max_frames)
        self._failure_log = FailureLog(self._log)
        self._converter = FrameConverter(self.br, settings.max_pixels)
        self._session = SubscriberSession(self, settings, self._log, lambda: self._end(EXIT_OK))
        self.subscription = FrameSubscription(
            self, 'video_frames', self._log, self.listener_callback, self._count_unreadable,
            SubscriptionOptions(transport=settings.transport, depth=settings.depth,
                                max_views=_MAX_VIEWS, max_pixels=settings.max_pixels,
                                decodes_video=settings.decodes_video))
        bag_sink = self._session.bag_sink
        self._bag_messages = BagMessages(
            self, self.subscription.topic_name, self._log, bag_sink.add_message,
        ) if bag_sink else None
        self._account: Account | None = None  # at the end
        self._recorded_topic = self.subscription.topic_name
        if bag_sink:
            bag_sink.read_losses(self._losses)
        topics, session = settings.topics.split(), self._session
        self._topic_recorder = TopicRecorder(
            self, topics, resolve_topic(self, 'video_frames'), self._log,
            session.record_messages,
        ) if topics else None
        self._timeout = settings.timeout
        self._timeout_timer = create_steady_timer(
            self, self._timeout, self._end_on_timeout) if self._timeout else None
        warn_unknown_parameters(self, PARAMETERS, self._log)
        self._log.info(
            f'Waiting for {self.subscription.topic_name}, writing to {self._session.folder}')
        use_priority(settings.priority)
        self.subscription.start()

    def listener_callback(self, received: ReceivedMessage) -> None:
        """
        Convert a message to a frame and record it; a bag takes the message itself.

        :param received: raw or compressed image, or video; the frame is a view of it.
        """
        if self.done.done():
            return
        if self._timeout_timer:
            self._timeout_timer.reset()
        topic = self.subscription.topic_name
        try:
            frame = (self._bag_messages.frame(received, topic) if self._bag_messages
                     else self._converter.convert(
                         received.message, topic, received.receive_ns, received.publisher,
                         received.number))
        except (CvBridgeError, ImageError) as err:
            self._count_unreadable(err)
        else:
            if isinstance(frame, MessageFrame):
                self._recorded_topic = frame.channel.topic
            self._session.record(frame)
            self._progress.tick(received.message.description, **self._lost())

    def hurry(self) -> None:
        """Leave the frames that wait to be written."""
        self._session.recorder.abandon()

    def close(self) -> int:
        """
        Record the remaining received frames and log a summary.

        :returns: the exit status.
        """
        with log_if_slow(self._log, 'Writing the received frames; Ctrl-C ends without them'):
            account = self._account = self._record_remaining()
            if self._bag_messages:
                self._bag_messages.close()
            if self._topic_recorder:
                self._topic_recorder.close()
            self._session.close()
        self._progress.close()
        recorder, counts = self._session.recorder, self._session.counts
        self._log.info(
            f'Received {self._progress.count - recorder.abandoned + counts.unprocessed} frames at '
            f'{self._progress.average_rate():.1f} Hz: '
            f'{counts.written} written to {self._session.folder}, {counts.dropped} dropped, '
            f'{counts.failed} failed, {account.lost + account.skipped} lost in transit'
            + account.uncounted
            + (f', {counts.unprocessed} not processed' if counts.unprocessed else '')
            + (f', {counts.left_out} left out before a key frame' if counts.left_out else '')
            + (f', {counts.skipped} skipped as requested' if counts.skipped else ''))
        has_topics = not self._topic_recorder or self._topic_recorder.log_summary()
        if counts.failed or counts.unprocessed or recorder.is_unfinished or not has_topics:
            return EXIT_FAILURE
        return super().close()

    def _record_remaining(self) -> Account:
        """Record received frames, and count those left; return what became of others."""
        if self.done.done():
            account = self.subscription.account  # without the frames that wait in vain
            self.subscription.destroy()
            return account
        deadline = time.monotonic() + _END_SECONDS
        unprocessed = self.subscription.close(lambda: self._session.wait_for_room(deadline))
        if not self.done.done():
            self._session.others.unprocessed += unprocessed
        return self.subscription.account

    def _count_unreadable(self, err: ImageError | CvBridgeError) -> None:
        """Count and log a message that cannot be recorded."""
        self._session.others.failed += 1
        self._failure_log.bad_frame(f'message not recorded: {err}')
        self._progress.tick('unreadable message', **self._lost())

    def _lost(self) -> dict[str, int]:
        account = self.subscription.account
        return {'dropped': self._session.recorder.counts.dropped,
                'lost': account.lost + account.skipped}

    def _losses(self) -> dict[str, dict[str, int]]:
        """Return for each topic how many messages are in no bag until now; on any thread."""
        account = self._account or self.subscription.account
        found = self._topic_recorder.losses() if self._topic_recorder else {}
        found[self._recorded_topic] = self._session.counts.losses(account.lost + account.skipped)
        return found

    def _end_on_timeout(self) -> None:
        """End with an error, because no frame arrived in time."""
        self._log.error(f'no frame on {self.subscription.topic_name} within {self._timeout:g} s: '
                        f'{self.subscription.explain_no_frames()}')
        self._end(EXIT_FAILURE)

    def _end(self, status: int) -> None:
        if not self.done.done():
            self.done.set_result(status)


#: What ``--help`` shows.
EXECUTABLE = Executable(
    name='img_subscriber', node='image_subscriber', settings=RecorderSettings,
    description='Record the images on video_frames as files.',
    example='-p output_dir:=/tmp/frames -p file_name:=f{seq:06d}.jpg')


def main(args: Sequence[str] | None = None) -> int:
    """
    Run the node.

    :param args: command line, program name first; None for the command line of the process.
    :returns: 0 on success, 1 if a frame or file failed, 2 for invalid parameters or arguments.
    """
    return run(EXECUTABLE, lambda _: ImageSubscriber(), args, failures=(RecordingError,))


if __name__ == '__main__':
    sys.exit(main())
