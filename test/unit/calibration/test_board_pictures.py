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

"""Boards as SVG and PDF files and as pixels."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import cv2
import numpy as np
from opencv_tools.calibration.board_pictures import (
    board_pdf, board_pixels, board_rectangles, board_svg)
from opencv_tools.calibration.boards import parse_board
import pytest
from rendered_boards import needs_markers

TEXTS = ('chessboard:9x6:25mm', 'charuco:11x8:30mm:21mm:5x5_250', 'aprilgrid:3x4:30mm:9mm:36h11')


def test_squares_of_a_chessboard() -> None:
    board = parse_board('chessboard:4x3:10mm')
    pixels = board_pixels(board, 1.0, edge=0)
    assert pixels.shape == (40, 50)
    np.testing.assert_array_equal(
        pixels[5::10, 5::10] // 255, np.indices((4, 5)).sum(axis=0) % 2)
    assert len(board_rectangles(board)) == 10


@needs_markers
@pytest.mark.parametrize('is_variant', [False, True])
def test_charuco_is_the_picture_of_opencv(is_variant: bool) -> None:
    board = parse_board('charuco:6x4:35mm:21mm:5x5_250')
    board = (board.variant or board) if is_variant else board
    theirs = cv2.aruco.CharucoBoard((6, 4), 0.035, 0.021, board.open_dictionary())
    theirs.setLegacyPattern(is_variant)
    ours = board_pixels(board, 1.0, edge=0)
    np.testing.assert_array_equal(ours, theirs.generateImage((210, 140)))


@needs_markers
def test_tags_are_those_of_apriltag() -> None:
    # The code of the first tag of 36h11, from the upper left in rows.
    bits = np.array([*f'{0xd5d628584:036b}'], int).reshape(6, 6)
    board = parse_board('aprilgrid:3x3:20mm:6mm:36h11')
    tag = board_pixels(board, 1.0, edge=0)[58:78, 6:26]
    np.testing.assert_array_equal(tag[5:-4:2, 5:-4:2] // 255, bits)
    assert (tag[:4] == 0).all() and (tag[:, :4] == 0).all()  # a border of two cells


@needs_markers
@pytest.mark.parametrize('text', TEXTS)
def test_svg_in_millimetres(text: str) -> None:
    board = parse_board(text)
    root = ElementTree.fromstring(board_svg(board))
    width, height = root.attrib['width'], root.attrib['height']
    assert width.endswith('mm') and height.endswith('mm')
    assert root.attrib['viewBox'] == f'0 0 {width[:-2]} {height[:-2]}'
    picture = np.full((int(float(height[:-2]) * 4), int(float(width[:-2]) * 4)), 255, np.uint8)
    for one in root.iter('{http://www.w3.org/2000/svg}rect'):
        x, y, w, h = (float(one.get(key, 0)) * 4 for key in ('x', 'y', 'width', 'height'))
        picture[round(y):round(y + h), round(x):round(x + w)] = (
            0 if one.get('fill') == '#000' else 255)
    whole = board_pixels(board, 4.0)
    np.testing.assert_array_equal(picture[:len(whole) - 1, :len(whole[0]) - 1], whole[:-1, :-1])


@needs_markers
@pytest.mark.parametrize('text', TEXTS)
def test_pdf_of_the_same_rectangles(text: str) -> None:
    board = parse_board(text)
    content = board_pdf(board)
    start = int(re.findall(rb'startxref\n(\d+)\n%%EOF\n$', content)[0])
    assert content[start:].startswith(b'xref\n0 6\n')
    for number, place in enumerate(re.findall(rb'(\d{10}) 00000 n', content), 1):
        assert content[int(place):].startswith(b'%d 0 obj\n' % number)
    length = int(re.findall(rb'/Length (\d+)', content)[0])
    body = content.partition(b'stream\n')[2]
    assert body[length:].startswith(b'\nendstream')
    shapes = re.findall(rb'^([01]) g ([\d.]+) ([\d.]+) ([\d.]+) ([\d.]+) re f$', body, re.M)
    expected = [(0 if one.is_black else 1, one.x + 12, one.y + 12, one.width, one.height)
                for one in board_rectangles(board)]
    np.testing.assert_allclose([[*map(float, one)] for one in shapes[:len(expected)]], expected,
                               atol=1e-4)
    box = re.findall(rb'/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]', content)[0]
    assert float(box[0]) == pytest.approx((board.size[0] * 1000 + 24) * 72 / 25.4, abs=1e-3)
    assert str(board).encode() in body


def test_too_large_picture() -> None:
    with pytest.raises(ValueError, match='give a smaller scale'):
        board_pixels(parse_board('chessboard:40x40:10cm'), 100.0)
