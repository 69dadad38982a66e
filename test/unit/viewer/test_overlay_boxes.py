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
"""Boxes of messages that anybody can publish."""

from __future__ import annotations

import math
import struct

from detections import CODEC, LabelledBox, serialized
from hypothesis import given, strategies as st
from opencv_tools.image.errors import CdrError
from opencv_tools.viewer.overlays.boxes import (
    BoxHeader, MAX_BOXES, MAX_BYTES, MAX_DETECTIONS, read_boxes, read_header)
import pytest

CUP: LabelledBox = (150, 100, 80, 40, 0.25, 'cup', 0.9)
NAN, INFINITE = math.nan, math.inf


def read(*boxes: LabelledBox) -> list[list[object]]:
    return read_boxes(memoryview(serialized(boxes))).as_json()


def test_header_and_boxes() -> None:
    data = memoryview(serialized([CUP, (1, 2, 3, 4, 0, 'dog', 0.95)], 1_700_000_000_123_456_789,
                                 'front'))
    assert read_header(data) == BoxHeader(1_700_000_000_123_456_789, 'front')
    boxes = read_boxes(data)
    assert boxes.as_json() == [[1, 2, 3, 4, 0, 'dog 0.95'], [150, 100, 80, 40, 0.25, 'cup 0.90']]
    assert boxes.describe() == '2 boxes'


def test_best_result_counts() -> None:
    results = [{'hypothesis': {'class_id': name, 'score': score}}
               for name, score in (('a', 0.2), ('b', 0.7), ('c', NAN), ('d', 0.1))]
    bbox = {'size_x': 1, 'size_y': 1}
    data = CODEC.write({'detections': [
        {'results': results, 'bbox': bbox, 'id': '17'}, {'results': [], 'bbox': bbox},
        {'results': results[2:3], 'bbox': bbox}]})
    assert [box[5] for box in read_boxes(memoryview(data)).as_json()] == ['b 0.70', '', 'c']


def test_big_endian_message() -> None:
    text = b'cup\0'
    fields = struct.pack('>iI', 3, 4) + struct.pack('>I1s3x', 1, b'') + struct.pack('>I', 1)
    fields += struct.pack('>iI', 0, 0) + struct.pack('>I1s3x', 1, b'') + struct.pack('>I', 1)
    fields += struct.pack('>I', len(text)) + text
    fields += bytes(-len(fields) % 8) + struct.pack('>d', 0.5) + bytes(43 * 8)
    fields += struct.pack('>5d', 10, 20, 0, 30, 40) + struct.pack('>I1s', 1, b'')
    data = memoryview(b'\0\0\0\0' + fields)
    assert read_header(data).stamp_ns == 3_000_000_004
    assert read_boxes(data).as_json() == [[10, 20, 30, 40, 0, 'cup 0.50']]


@pytest.mark.parametrize('place', [
    (NAN, 1, 2, 3, 0), (1, INFINITE, 2, 3, 0), (1, 1, NAN, 3, 0), (1, 1, -2, 3, 0),
    (1, 1, 2, 0, 0), (1, 1, 2, 3, INFINITE), (1, 1, 2, 3, NAN), (1e30, 1, 2, 3, 0),
    (1, -1e7, 2, 3, 0), (1, 1, 1e300, 3, 0), (1, 1, 2, INFINITE, 0)])
def test_box_without_a_valid_place(place: tuple[float, float, float, float, float]) -> None:
    boxes = read_boxes(memoryview(serialized([(*place, 'a', 1.0), CUP])))
    assert [box.label for box in boxes.shown] == ['cup 0.90']
    assert boxes.describe() == '1 box, 1 left out without a valid place'


def test_labels_are_cleaned_and_short() -> None:
    (box,) = read((1, 2, 3, 4, 0, '<b>\x1b[2J\n\u202e' + 'x' * 10_000, 1e300))
    assert str(box[5]).startswith('<b>\\x1b[2J\\n\\u202exxx') and len(str(box[5])) == 40
    broken = serialized([(1, 2, 3, 4, 0, 'name', 0.5)]).replace(b'name', b'\xff\xfe\xfd\xfc')
    assert read_boxes(memoryview(broken)).shown[0].label == '\ufffd\ufffd\ufffd\ufffd 0.50'


def test_many_turns_are_few() -> None:
    (box,) = read((1, 2, 3, 4, 1000 * math.tau + 0.5, 'a', 1))
    assert box[4] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.thorough
def test_boxes_with_the_highest_scores() -> None:
    boxes = read_boxes(memoryview(serialized([
        (number, 2, 3, 4, 0, 'a', NAN if number % 10 == 0 else number / 10_000)
        for number in range(10_000)])))
    assert [box.place[0] for box in boxes.shown] == [
        number for number in range(9999, 0, -1) if number % 10][:MAX_BOXES]
    assert boxes.describe() == '500 of 10000 boxes, those with the highest scores'


@pytest.mark.thorough
def test_largest_number_of_boxes_is_within_the_largest_size() -> None:
    data = memoryview(serialized([CUP] * MAX_DETECTIONS, 5))
    assert read_header(data) == BoxHeader(5, '')
    assert read_boxes(data).others == MAX_DETECTIONS - MAX_BOXES


def test_limits() -> None:
    too_many = bytearray(serialized([]))
    too_many[-4:] = struct.pack('<I', MAX_DETECTIONS + 1)
    with pytest.raises(CdrError, match='it has 10001 detections: 10000 are the limit'):
        read_boxes(memoryview(too_many))
    with pytest.raises(CdrError, match=f'it has {MAX_BYTES + 1} bytes: {MAX_BYTES} are the limit'):
        read_header(memoryview(bytes(MAX_BYTES + 1)))


@pytest.mark.parametrize('data', [b'', b'\0', b'\0\1', b'\0\7\0\0' + bytes(100), b'\0\1\0\0abc'])
def test_no_message(data: bytes) -> None:
    for reading in (read_header, read_boxes):
        with pytest.raises(CdrError):
            reading(memoryview(data))


def test_message_that_is_cut_off() -> None:
    data = serialized([CUP, CUP], 5, 'front')
    for size in range(len(data)):
        with pytest.raises(CdrError):
            read_boxes(memoryview(data[:size]))


@given(st.binary(max_size=300), st.integers(0, 2**32 - 1), st.integers(0, 600))
def test_any_bytes_are_boxes_or_an_error(content: bytes, number: int, at: int) -> None:
    changed = bytearray(serialized([CUP], 5, 'front'))
    changed[at:at + 4] = struct.pack('<I', number)
    for data in (b'\0\1\0\0' + content, bytes(changed)):
        try:
            boxes = read_boxes(memoryview(data))
        except CdrError:
            continue
        for *place, label in boxes.as_json():
            assert all(abs(one) <= 1e6 for one in place) and str(label).isprintable()
