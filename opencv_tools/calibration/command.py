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

"""The command img_calibrate: its actions, the files it writes and its report."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Sequence
import os
from pathlib import Path
import sys

import numpy as np
from opencv_tools.base.logs import ConsoleWriter, Log
from opencv_tools.base.regular_files import user_path
from opencv_tools.calibration.board_pictures import print_board
from opencv_tools.calibration.boards import Board, CalibrationError, CHARUCO, parse_board
from opencv_tools.calibration.camera_file import (
    CameraInfoError, check_camera_name, check_output, read_camera, StoredCamera, write_camera)
from opencv_tools.calibration.check import Check, check_camera, GOOD, stored_camera
from opencv_tools.calibration.least_squares import Floats
from opencv_tools.calibration.solve import Calibration, solve
from opencv_tools.calibration.stereo import solve_stereo
from opencv_tools.calibration.verdict import BAD, judge
from opencv_tools.calibration.view_search import FoundViews, search_sources
from opencv_tools.capture.errors import CaptureError, TopicError

_SHOWN_REASONS = 4


def report_search(found: FoundViews, board: Board) -> None:
    """Print how many views were taken, and why the others were not."""
    taken = len(found.views[0])
    print(f'Views: {taken} of {found.searched} images')
    for reason, count in found.reasons.most_common(_SHOWN_REASONS):
        print(f'  {count} not taken: {reason}')
    if found.is_variant:
        print(f'The board has the other layout of {board.kind}: '
              + ('that of OpenCV before 4.6' if board.kind == CHARUCO else
                 'black borders of one cell'))


def report_check(result: Check) -> None:
    """Print the result of a check."""
    print(f'Error: {result.rms:.3f} pixels, {result.best:.3f} for a new calibration')
    print(_cells_text(result.cell_errors))
    print(f'Verdict: {result.word}' + (f'\n  {result.reason}' if result.reason else ''))


def report_calibration(lens: Calibration, name: str) -> None:
    """Print a calibration."""
    verdict = judge(lens)
    names = ['fx', 'fy', 'cx', 'cy', *(f'd{number}' for number in range(1, len(lens.d) + 1))]
    values = [lens.k[0, 0], lens.k[1, 1], lens.k[0, 2], lens.k[1, 2], *lens.d]
    print(f'Calibration{name and " " + name} of {lens.size[0]}x{lens.size[1]} pixels, '
          f'{lens.model}:')
    for key, value, deviation in zip(names, values, lens.deviations):
        print(f'  {key} {value:.6g} +- {deviation:.2g}')
    print(f'Error: {lens.rms:.3f} pixels'
          + (f', {lens.held_out:.3f} in views that were left out' if lens.held_out > 0 else ''))
    print(_cells_text(lens.cell_errors))
    print(f'Verdict: {verdict.word}')
    for reason in verdict.reasons:
        print(f'  {reason}')


def _cells_text(cells: Floats) -> str:
    rows = ['  ' + ' '.join('   - ' if np.isnan(value) else f'{value:5.2f}' for value in row)
            for row in cells]
    return '\n'.join(('Error by part of the image in pixels:', *rows))


def check_found(camera: StoredCamera, found: FoundViews, board: Board) -> bool:
    """Check a calibration, print the result, and return whether it is good."""
    report_search(found, board)
    result = check_camera(camera, found.views[0])
    report_check(result)
    return result.word == GOOD


def calibrate_found(
    found: FoundViews, board: Board, model: str, name: str, paths: Sequence[Path],
) -> bool:
    """
    Calibrate one camera or two, print a report, and write the files if all are usable.

    :param found: views of each camera; those of two cameras are pairs.
    :param paths: files, one for each camera; empty for none.
    :returns: whether the calibration is usable.
    :raises CalibrationError: the views determine no calibration.
    :raises CameraInfoError: a file cannot be written.
    """
    names = [''] if len(found.views) < 2 else ['left', 'right']
    try:
        lenses = [solve(one, model) for one in found.views]
        is_usable = all(judge(lens).word != BAD for lens in lenses)
        stereo = solve_stereo([*zip(*found.views)], *lenses) if is_usable and names[0] else None
        parts = (stereo.left, stereo.right) if stereo else (None,)
        for path, lens, part, suffix in zip(paths if is_usable else (), lenses, parts, names):
            camera = stored_camera(lens, part.r, part.p) if part else stored_camera(lens)
            write_camera(path, camera, f'{name}_{suffix}' if suffix else name)
    finally:  # the files come first, because nobody may read the report
        report_search(found, board)
    for lens, one in zip(lenses, names):
        report_calibration(lens, one)
    if not is_usable:
        raise CalibrationError('nothing was written, because the calibration is bad')
    if stereo:
        print(f'Baseline: {stereo.baseline:.6g} m from {stereo.pairs} pairs, '
              f'error {stereo.rms:.3f} pixels')
    for path in paths:
        print(f'Wrote {path}')
    return True


_EXIT_OK = 0
_EXIT_FAILURE = 1

#: Finds views in the images of live topics: of one camera, or of the left and the right one.
TopicSearch = Callable[[Board, Sequence[str], Log], FoundViews]


def _source(options: Namespace) -> str:
    return options.sources[0] if options.sources else ''


def _is_live(options: Namespace) -> bool:
    """Return whether the images are those of live topics."""
    return bool(options.topic) and not _source(options)


def _is_stereo(options: Namespace) -> bool:
    """Return whether there are two cameras."""
    return bool(options.right_topic if _is_live(options) else options.right)


def calibrate(options: Namespace, search_topics: TopicSearch | None = None) -> int:
    """
    Calibrate or check a camera, or write a board, and print a report.

    :param options: options of the command line, see `cli`.
    :param search_topics: search of live topics; None if they are not supported.
    :returns: the exit status.
    :raises ValueError: an argument is invalid.
    """
    board = parse_board(options.board)
    _check_options(options)
    if _is_stereo(options) and board.is_symmetric:
        raise ValueError(f'{board} looks the same after half a turn, so that the corners of two '
                         'cameras cannot be paired: use a board with markers, or a chessboard of '
                         'an even and an odd number of corners')
    log = Log(ConsoleWriter('img_calibrate'))
    if options.board_pdf:
        print_board(board, user_path(options.board_pdf))
        log.info(f'wrote {options.board_pdf}: print it at 100 % and check its ruler')
        if not _source(options) and not _is_live(options):
            return _EXIT_OK
    camera = read_camera(user_path(options.check), log.warning) if options.check else None
    outputs = [user_path(text) for text in (options.output, options.right_output) if text]
    try:
        for path in outputs:
            check_output(path)
        found = _search(options, board, log, search_topics)
        is_good = check_found(camera, found, board) if camera else calibrate_found(
            found, board, options.model, options.name, outputs)
        sys.stdout.flush()
        return _EXIT_OK if is_good else _EXIT_FAILURE
    except TopicError as err:
        raise ValueError(str(err)) from err
    except (CaptureError, CalibrationError, CameraInfoError) as err:
        log.error(str(err))
    except BrokenPipeError:  # the reader of the report has ended
        pass
    except OSError as err:
        log.error(f'the report cannot be written: {err.strerror}')
    return _EXIT_FAILURE


def _search(
    options: Namespace, board: Board, log: Log, search_topics: TopicSearch | None,
) -> FoundViews:
    if not _is_live(options):
        sources = [(_source(options), options.topic), (options.right, options.right_topic)]
        return search_sources(board, sources if options.right else sources[:1], log)
    if search_topics is None:
        raise ValueError('live topics are not supported here: use the command img_calibrate')
    topics = [options.topic, options.right_topic]
    try:
        return search_topics(board, topics if options.right_topic else topics[:1], log)
    except ImportError as err:
        raise CaptureError(f'live topics need ROS 2, but {err}: source its setup.bash, or give '
                           'a source') from err


def _check_options(options: Namespace) -> None:
    """
    Check the arguments against each other.

    :raises ValueError: one is invalid.
    """
    try:
        check_camera_name(options.name)
    except ValueError as err:
        raise ValueError(f'--name is {options.name!r:.80}: {err}') from err
    _check_sources(options)
    _check_files(options)


def _check_sources(options: Namespace) -> None:
    if len(options.sources) > 1:
        raise ValueError(f'{len(options.sources)} sources are given: give a folder, or put the '
                         "pattern in quotes, as '*.png'")
    if not _source(options) and options.right:
        raise ValueError('the source is missing: give it before --right')
    if options.right_topic and not (options.right or _is_live(options)):
        raise ValueError('--right-topic needs --right with a bag, or --topic for two live topics')
    if not (_source(options) or _is_live(options)) and (
            options.output or options.check or not options.board_pdf):
        raise ValueError('the source is missing: give image files, a folder, a video or a bag, '
                         'or a live topic with --topic')


def _check_files(options: Namespace) -> None:
    is_stereo, option = _is_stereo(options), '--right-topic' if _is_live(options) else '--right'
    if options.check and (options.output or is_stereo):
        raise ValueError('--check writes nothing and takes one camera: leave out -o, and --right '
                         'or --right-topic')
    if is_stereo and _images(_source(options), options.topic) == _images(
            options.right, options.right_topic):
        raise ValueError('the images of the left and of the right camera are the same: give those '
                         f'of the right camera with {option}')
    if options.right_output and not is_stereo:
        raise ValueError('--right-output needs --right, or --right-topic without a source: give '
                         'the images of the right camera')
    if is_stereo and bool(options.output) != bool(options.right_output):
        raise ValueError('two cameras have two files: give -o and --right-output')
    if options.right_output and user_path(options.output) == user_path(options.right_output):
        raise ValueError('-o and --right-output are the same file: give two files')


def _images(source: str, topic: str) -> tuple[str, str]:
    """Return the file and the topic of images; both are equal for the same images."""
    return os.path.realpath(user_path(source)), topic and f'/{topic.removeprefix("/")}'
