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

"""Node ``image_viewer``: shows image topics in browsers."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import sys

from opencv_tools.base.logs import Log, log_if_slow
from opencv_tools.base.remedies import installation
from opencv_tools.nodes.declaration import declare_settings, warn_unknown_parameters
from opencv_tools.nodes.executable import Executable
from opencv_tools.nodes.run_node import ClosableNode, EXIT_FAILURE, run
from opencv_tools.recording.errors import RecordingError
from opencv_tools.viewer.control import CameraControl
from opencv_tools.viewer.errors import ViewerError
from opencv_tools.viewer.executor_calls import ExecutorCalls
from opencv_tools.viewer.graph import Graph
from opencv_tools.viewer.node_table import list_graph
from opencv_tools.viewer.parameters import PARAMETERS, ViewerSettings
from opencv_tools.viewer.recording.page_recorder import PageRecorder


class ImageViewer(ClosableNode):
    """Serve a page with all image topics."""

    def __init__(self) -> None:
        """
        Start the server; it subscribes when somebody looks.

        :raises ParameterError: the value of a parameter is invalid.
        :raises RecordingError: the folder of recordings cannot be used.
        :raises ViewerError: the server cannot start.
        """
        super().__init__('image_viewer', automatically_declare_parameters_from_overrides=True)
        try:
            from opencv_tools.viewer.server import ViewerServer
        except ModuleNotFoundError as err:
            if not str(err.name).startswith('tornado'):
                raise
            raise ViewerError('img_viewer needs Tornado; '
                              f'{installation("tornado")}') from err
        settings = declare_settings(self, ViewerSettings)
        log = self._log = Log(self.get_logger())
        calls = self._calls = ExecutorCalls(self, log)
        self._recorder = PageRecorder(
            self, settings.record_dir, lambda work: calls.start(work, lambda _: None), log,
        ) if settings.record_dir else None
        self._graph = Graph(self, settings.patterns, settings.transport, log,
                            CameraControl(self, self._recorder) if settings.control else None)
        self._server = ViewerServer(
            settings, self.get_fully_qualified_name(), self._graph, calls, log, self._fail)
        warn_unknown_parameters(self, PARAMETERS, log)
        url, *others = self._server.urls
        invitation = ', or '.join([f'Open {url} in a browser', *others])
        if self._server.has_token:
            with suppress(OSError):  # nobody reads; log files and /rosout would keep the token
                print(invitation, file=sys.stderr, flush=True)
        else:
            log.info(invitation)
        if self._server.fingerprint:
            log.info('The certificate was created by this node. Browsers warn of it; its SHA-256 '
                     f'is {self._server.fingerprint}')

    def hurry(self) -> None:
        """
        Leave the frames that wait to be recorded.

        :raises KeyboardInterrupt: nothing is being recorded.
        """
        if not (self._recorder and self._recorder.abandon()):
            super().hurry()

    def close(self) -> int:
        """
        Finish the recording, close all pages and unsubscribe.

        :returns: the exit status.
        """
        if self._recorder:
            with log_if_slow(
                    self._log, 'Writing the received frames; Ctrl-C ends without them'):
                self._recorder.close()
        self._server.close()
        self._calls.close()
        self._graph.close_all()
        self.get_logger().info('Closed all pages')
        return super().close()

    def _fail(self) -> None:
        self.done.set_result(EXIT_FAILURE)


#: What ``--help`` shows.
EXECUTABLE = Executable(
    name='img_viewer', node='image_viewer', settings=ViewerSettings,
    description='Show image topics in a browser.',
    example='-p address:=0.0.0.0 -p port:=8080')


def main(args: Sequence[str] | None = None) -> int:
    """
    Run the node.

    :param args: command line, program name first; None for the command line of the process.
    :returns: 0 on success, 1 if the server cannot start, 2 for invalid parameters or arguments.
    """
    if '--list' in (words := sys.argv if args is None else args):
        return list_graph(words)
    return run(EXECUTABLE, lambda _: ImageViewer(), args, failures=(RecordingError, ViewerError))


if __name__ == '__main__':
    sys.exit(main())
