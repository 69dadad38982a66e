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

"""Searches for a board in messages of every encoding."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from typing import Any

from console import Console
import cv2
from images import random_image
import numpy as np
from opencv_tools.calibration import detection
from opencv_tools.calibration.boards import parse_board
from opencv_tools.calibration.detection import BoardFinder
from opencv_tools.cv_bridge import CvBridgeError
from opencv_tools.image.cdr import NO_HEADER, WireCompressedImage, WireImage
from opencv_tools.image.encodings import ENCODINGS, find_encoding
from opencv_tools.image.errors import ImageError
from opencv_tools.image.layout import array_to_wire
from opencv_tools.image_codecs import encode_image
from opencv_tools.topics.queue import ReceivedMessage
from opencv_tools.viewer.calibrate import board_search
from opencv_tools.viewer.calibrate.board_search import (
    BoardSearch, gray_image, search, search_fast, ThoroughPace)
from opencv_tools.viewer.calibrate.session import Session
from opencv_tools.viewer.streams.stream import Stream
import pytest
from rendered_boards import needs_markers, poses, wide_camera
from waiting import pause_loop, until

pytestmark = needs_markers

BOARD = parse_board('charuco:9x6:40mm:30mm:4x4_50')


def picture() -> np.ndarray:
    camera = wide_camera(640, 360)
    return camera.see(BOARD, poses(BOARD, camera, 1, seed=4, is_whole=True)[0])


def wire(image: np.ndarray, encoding: str) -> WireImage:
    return array_to_wire(image, find_encoding(encoding))


@pytest.mark.parametrize('encoding', [
    *ENCODINGS, '8UC1', '8UC3', '16UC1', '16SC1', '32SC1', '32FC1', '64FC1', '32FC3', '16UC3'])
def test_every_encoding_becomes_gray(encoding: str) -> None:
    gray = gray_image(wire(random_image(encoding, 48, 64), encoding))
    assert (gray.shape, gray.dtype) == ((48, 64), np.uint8)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(('encoding', 'convert'), [
    ('mono8', lambda gray: gray), ('bgr8', lambda gray: cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)),
    ('mono16', lambda gray: gray.astype(np.uint16) * 3), ('bayer_rggb8', lambda gray: gray),
    ('32FC1', lambda gray: gray.astype(np.float32) / 255)])
def test_board_in_an_encoding(encoding: str, convert: Any) -> None:
    gray = gray_image(wire(convert(picture()), encoding))
    found, seconds = search(BoardFinder(BOARD), gray, True)
    assert len(found.ids) == len(BOARD.corners()) and not found.problem
    assert seconds > 0


def test_board_in_a_jpeg() -> None:
    data = encode_image(picture(), '.jpg').tobytes()
    gray = gray_image(WireCompressedImage(header=NO_HEADER, format='jpeg', data=data))
    found, _ = search(BoardFinder(BOARD), gray, False)
    assert len(found.ids) == len(BOARD.corners())


@pytest.mark.parametrize('message', [
    wire(np.zeros((0, 0, 3), np.uint8), 'bgr8'), wire(np.zeros((8193, 4096), np.uint8), 'mono8'),
    WireCompressedImage(header=NO_HEADER, format='jpeg', data=b'\xff\xd8' + bytes(1000)),
    WireImage(header=NO_HEADER, height=2**31, width=2**31, encoding='bgr8', is_bigendian=False,
              step=0, data=b'')])
def test_image_that_is_not_searched(message: Any) -> None:
    with pytest.raises((ImageError, CvBridgeError)):
        gray_image(message)
    with pytest.raises(ImageError):
        search_fast(BoardFinder(BOARD), message)


@pytest.mark.thorough
def test_chessboard_in_a_large_image() -> None:
    board, camera = parse_board('chessboard:9x6:25mm'), wide_camera()
    picture = camera.see(board, poses(board, camera, 1, seed=4, is_whole=True)[0])
    small, _ = search(BoardFinder(board), picture, False)
    large, _ = search(BoardFinder(board), cv2.resize(picture, (3840, 2160)), False)
    assert (large.size, large.problem) == ((3840, 2160), '')
    assert (large.ids == small.ids).all()
    np.testing.assert_allclose(large.corners, (small.corners + 0.5) * 3 - 0.5, atol=0.5)


def test_small_copy_of_a_large_image_is_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    searched: list[int] = []
    monkeypatch.setattr(
        detection, '_chessboard', lambda gray, *_, **__: searched.append(gray.size))
    image = np.zeros((2160, 3840), np.uint8)
    found, _ = search(BoardFinder(parse_board('chessboard:9x6:25mm')), image, False)
    assert not found.is_found and found.size == (3840, 2160)
    # Noise of the whole size takes half a minute. The second search is for a miscounted board.
    assert searched == [1920 * 1080, 640 * 360]


def test_slow_thorough_search_is_rare() -> None:
    pace = ThoroughPace()
    assert pace.is_due(5.0)
    pace.ended(5.0, 0.1)
    assert (pace.is_due(5.9), pace.is_due(6.1)) == (False, True)
    pace.ended(10.0, 2.0)
    assert (pace.is_due(15.9), pace.is_due(16.1)) == (False, True)


@pytest.mark.parametrize(('seconds', 'shown'), [(0.0, 2), (1e9, 1)])
def test_pages_wait_for_quick_searches_only(
        seconds: float, shown: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(board_search, '_SHOWN_SECONDS', seconds)
    seen: list[str] = []

    async def work() -> None:
        with ThreadPoolExecutor(1) as thread:
            stream = Stream(7, ('/image', 'raw'), asyncio.get_running_loop(), thread, Console())
            session, go_on = Session(), Event()
            session.choose('chessboard:9x6:25mm')
            search_of_stream = BoardSearch(
                stream, session, thread, lambda: True, lambda frame, _: seen.append(frame))
            for number in (1, 2):
                stream.feed.put(ReceivedMessage(
                    wire(np.full((90, 120), 90, np.uint8), 'mono8'), 0, number=number))
                if number == 1:
                    await until(lambda: len(seen) == 1)
                    await pause_loop(0.0)
                    thread.submit(go_on.wait)
            found = stream.searched()
            go_on.set()
            assert found and found.number == shown
            await until(lambda: len(seen) == 2)
            await pause_loop(0.0)
            found = stream.searched()
            assert found and found.number == 2
            search_of_stream.close()
            stream.feed.put(ReceivedMessage(
                wire(np.full((90, 120), 90, np.uint8), 'mono8'), 0, number=3))
            found = stream.searched()
            assert found and found.number == 3

    asyncio.run(work())
    assert seen == ['0/1', '0/2']


@pytest.mark.parametrize('size', [(1, 1), (1, 640), (2, 2), (3000, 1)])
@pytest.mark.parametrize('text', [
    'charuco:9x6:40mm:30mm:4x4_50', 'chessboard:9x6:25mm', 'aprilgrid:6x6:30mm:9mm:36h11'])
@pytest.mark.parametrize('is_fast', [False, True])
def test_image_of_odd_size_has_no_board(
        size: tuple[int, int], text: str, is_fast: bool) -> None:
    gray = np.full(size, 90, np.uint8)
    found, _ = search(BoardFinder(parse_board(text)), gray, is_fast)
    assert not found.is_found and found.problem
    assert found.size == size[::-1]
