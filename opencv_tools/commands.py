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

"""
Entry points of the executables.

This module imports nothing that takes long, so signals are handled before the long imports begin.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
import os
import signal
import sys
from typing import Any

from opencv_tools.base.signals import end_at_signals


def _load(module: str) -> Any:
    """Import the module of an executable that multiplies no large matrices."""
    # numpy's OpenBLAS would start a thread for each processor, which takes as long as its import.
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    return import_module(module)


def _run(name: str, failure: int, run: Callable[[], int]) -> int:
    """Run a command; print one sentence about a known library that cannot be imported."""
    try:
        return int(run())
    except ImportError as err:
        sentence = _load('opencv_tools.base.remedies').explain_missing(err)
        if not sentence:
            raise
        print(f'{name}: error: {sentence}', file=sys.stderr)
        return failure


def _load_ros(name: str, module: str, load: Callable[[str], Any] = _load) -> Any:
    """Import a module that uses ROS; exit with 2 if a variable keeps ROS from starting."""
    sentence = import_module('opencv_tools.base.remedies').explain_variables()
    if sentence:  # rcl would end the process with status 102, or wait for ever
        print(f'{name}: error: {sentence}', file=sys.stderr)
        raise SystemExit(2)
    return load(module)


def _run_node(name: str, module: str, load: Callable[[str], Any] = _load) -> int:
    def run() -> int:
        if sys.argv[1:2] not in ([], ['--ros-args']):  # before ROS, which takes longer
            load('opencv_tools.nodes.help_text').check_options(name, sys.argv)
        return int(_load_ros(name, module, load).main())

    # A shell script starts background processes with SIGINT ignored. A node ends in spite of it.
    return end_at_signals(lambda: _run(name, 1, run), status=0, ignorable=(signal.SIGHUP,))


def _run_robot_command(name: str) -> int:
    return end_at_signals(lambda: _run(
        name, 2, lambda: getattr(_load('opencv_tools.robot.cli'), name)()))


def img_calibrate() -> int:
    """Run ``img_calibrate`` and return the exit status."""
    return end_at_signals(lambda: _run('img_calibrate', 1, lambda: _load(
        'opencv_tools.calibration.cli').main(search_topics=_search_topics)), status=1)


def _search_topics(*arguments: Any) -> Any:
    return _load_ros('img_calibrate', 'opencv_tools.topic_views').search_topics(*arguments)


def img_convert() -> int:
    """Run ``img_convert`` and return the exit status."""
    return end_at_signals(lambda: _run(
        'img_convert', 2, lambda: _load('opencv_tools.convert.cli').main()), status=1)


def opencv_tools_info() -> int:
    """Run ``opencv_tools_info`` and return the exit status."""
    return end_at_signals(lambda: int(_load('opencv_tools.base.info').main()))


# The user's function may multiply matrices.
img_filter = partial(_run_node, 'img_filter', 'opencv_tools.image_filter', import_module)
img_publisher = partial(_run_node, 'img_publisher', 'opencv_tools.basic_image_publisher')
img_subscriber = partial(_run_node, 'img_subscriber', 'opencv_tools.basic_image_subscriber')
img_viewer = partial(_run_node, 'img_viewer', 'opencv_tools.image_viewer')
robot_compare = partial(_run_robot_command, 'robot_compare')
robot_frames = partial(_run_robot_command, 'robot_frames')
robot_view = partial(_run_robot_command, 'robot_view')
sdf_to_urdf = partial(_run_robot_command, 'sdf_to_urdf')
urdf_to_sdf = partial(_run_robot_command, 'urdf_to_sdf')
