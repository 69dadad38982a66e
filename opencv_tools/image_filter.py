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

"""Node ``image_filter``: applies a function to the images of a topic and publishes the results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
import sys
from typing import Any

from opencv_tools.base.logs import Log
from opencv_tools.base.progress import Progress
from opencv_tools.base.rate_limit import MAX_RATE
from opencv_tools.frames.frame import check_target, Frame
from opencv_tools.frames.node import FrameNode, ImageFunction
from opencv_tools.image.encodings import find_encoding
from opencv_tools.image.picture_formats import reduction
from opencv_tools.nodes.declaration import (
    declare_settings, warn_unknown_parameters, watch_parameters)
from opencv_tools.nodes.executable import Executable
from opencv_tools.nodes.parameters import (
    parameter, parameter_group, parameter_table, rate_parameter, with_values)
from opencv_tools.nodes.run_node import EXIT_FAILURE, EXIT_OK, run
from opencv_tools.nodes.settings import FULL_HD_BYTES, NodeSettings, priority_parameter
from opencv_tools.nodes.video_settings import check_video
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.topic_discovery import TRANSPORTS
from opencv_tools.transport.scheduling import use_priority
from opencv_tools.video.settings import VideoSettings
import yaml


@dataclass(frozen=True, kw_only=True)
class FilterSettings(NodeSettings):
    """Values of the parameters of ``img_filter``."""

    function: str = parameter(
        '', 'Function to apply to each image, as module:function, for example cv2:Canny',
        ends=True)
    arguments: str = parameter(
        '', 'Arguments of the function after the image, for example: 50, 150, apertureSize=5')
    encoding: str = parameter(
        'bgr8', 'Encoding of the array that the function gets; empty for that of the messages',
        check=check_target)
    every: bool = parameter(
        False, 'Whether to filter every frame; false to skip frames while the function runs')
    transport: str = parameter(
        'auto', 'Type of the received images; auto prefers shm to raw, raw to '
        'compressed, and video or compressedDepth from another machine',
        choices=tuple(TRANSPORTS))
    max_rate: float = rate_parameter(
        0.0, 'Maximum rate of the filtered frames in Hz, by their stamps; 0 for no limit',
        MAX_RATE)
    video: VideoSettings = parameter_group(VideoSettings(), 'video_')
    priority: int = priority_parameter()
    FRAME_BYTES = FULL_HD_BYTES


#: Parameters of ``img_filter``.
PARAMETERS = parameter_table(FilterSettings)


class ImageFilter(FrameNode):
    """Receive ``video_frames``, apply a function, and publish ``filtered_frames``."""

    def __init__(self) -> None:
        """
        Load the function and subscribe.

        :raises ParameterError: the value of a parameter is invalid.
        """
        super().__init__('image_filter', automatically_declare_parameters_from_overrides=True)
        settings = declare_settings(self, FilterSettings)
        check_video(settings.video)
        self._settings = settings
        arguments, keywords = parse_arguments(settings.arguments)
        self._function = ImageFunction(load_function(settings.function), arguments, keywords)
        self._failed = self._unfiltered = 0
        self._log = Log(self.get_logger())
        self._progress = Progress(self._log.info, 'Filtering video frame')
        self._publisher = self.publish_frames('filtered_frames', video=settings.video)
        self._subscriber = self.receive_frames(
            'video_frames', self.listener_callback, encoding=settings.encoding,
            every=settings.every, transport=settings.transport, max_rate=settings.max_rate)
        warn_unknown_parameters(self, PARAMETERS, self._log)
        watch_parameters(self, PARAMETERS, self._apply, check_together=self._check)
        self._log.info(
            f'Waiting for {self._subscriber.topic_name}, publishing to '
            f'{self._publisher.topic_name}')
        use_priority(settings.priority)

    def listener_callback(self, frame: Frame) -> None:
        """Filter a frame and publish the result, if it has subscribers."""
        if not self._publisher.has_subscribers:
            self._unfiltered += 1
            self._log.warning(
                'the function is called only while the results have subscribers, and '
                f'{self._publisher.topic_name} has none', once='no subscribers')
            self._progress.tick('not filtered without subscribers', **self._lost())
            return
        lost = reduction(find_encoding(frame.raw_encoding), find_encoding(frame.encoding))
        if lost:
            self._log.warning(f'{lost}, as the parameter encoding has it; an empty encoding gives '
                              'them to the function as they are', once='encoding')
        try:
            self._function.publish(frame, self._publisher)
        except Exception as err:  # noqa: B902 (the function may raise anything)
            self._failed += 1
            reason = ' '.join(str(err).split())
            self._log.error(f'frame not filtered: {type(err).__name__}: {reason}',
                            every=1.0, key='not filtered')
        self._progress.tick(frame.description, **self._lost())

    def close(self) -> int:
        """
        Unsubscribe and log a summary.

        :returns: the exit status.
        """
        skipped = self._subscriber.skipped
        failed = self._failed + self._subscriber.failed
        unfit, before = self._publisher.without_form, self._subscriber.before
        super().close()
        self._log.info(
            f'Received {self._progress.count} frames at {self._progress.average_rate():.1f} Hz: '
            f'{failed} failed, {skipped} skipped'
            + (f', {self._unfiltered} not filtered without subscribers'
               if self._unfiltered else '')
            + (f', {unfit} in no form that its subscribers receive' if unfit else '')
            + (f', {before} sent before the first received frame' if before else ''))
        return EXIT_FAILURE if failed else EXIT_OK

    def _check(self, changes: dict[str, Any]) -> None:
        stream = self._publisher.video
        check_video(with_values(self._settings, changes).video, stream.size if stream else None)

    def _apply(self, changes: dict[str, Any]) -> None:
        self._settings = with_values(self._settings, changes)
        if self._publisher.video:
            self._publisher.video.settings = self._settings.video

    def _lost(self) -> dict[str, int]:
        return {'skipped': self._subscriber.skipped,
                'failed': self._failed + self._subscriber.failed}


def load_function(name: str) -> Callable[..., Any]:
    """
    Import a function.

    :param name: ``module:function``, or ``module.function``; modules of the working folder are
        found as well.
    :raises ParameterError: there is no such function.
    """
    module_name, _, attribute = name.rpartition(':' if ':' in name else '.')
    problem = 'give module:function, for example cv2:Canny'
    if module_name and attribute:
        here = str(Path.cwd())
        if here not in sys.path:
            sys.path.append(here)
        try:
            found: Any = import_module(module_name)
            for part in attribute.split('.'):
                found = getattr(found, part)
        except Exception as err:  # noqa: B902 (a module of the user may raise anything)
            problem = f'{type(err).__name__}: {err}'
        else:
            if callable(found):
                function: Callable[..., Any] = found
                return function
            problem = 'it is not a function'
    raise ParameterError(f'parameter function is {name!r}: {problem}')


def parse_arguments(text: str) -> tuple[list[Any], dict[str, Any]]:
    """
    Read arguments of a function.

    :param text: values separated by commas, in YAML, with or without a name:
        ``50, 150, apertureSize=5``. Lists stand in brackets.
    :returns: positional arguments and keyword arguments.
    :raises ParameterError: the text is invalid.
    """
    positional: list[Any] = []
    keywords: dict[str, Any] = {}
    try:
        for item in yaml.safe_load(f'[{text}]'):
            name, equals, value = item.partition('=') if isinstance(item, str) else ('', '', '')
            if equals and name.strip().isidentifier():
                keywords[name.strip()] = yaml.safe_load(value)
            else:
                positional.append(tuple(item) if isinstance(item, list) else item)
    except yaml.YAMLError as err:
        raise ParameterError(f'parameter arguments is {text!r}: give values separated by commas, '
                             'for example 50, 150') from err
    return positional, keywords


#: What ``--help`` shows.
EXECUTABLE = Executable(
    name='img_filter', node='image_filter', settings=FilterSettings,
    description='Apply a function to the images on video_frames; publish filtered_frames.',
    example="-p function:=cv2:Canny -p arguments:='50, 150' -p encoding:=mono8")


def main(args: Sequence[str] | None = None) -> int:
    """
    Run the node.

    :param args: command line, program name first; None for the command line of the process.
    :returns: 0 on success, 1 if a frame failed, 2 for invalid parameters or arguments.
    """
    return run(EXECUTABLE, lambda _: ImageFilter(), args, failures=())


if __name__ == '__main__':
    sys.exit(main())
