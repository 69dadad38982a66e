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

"""Files of frames: names, formats, and a recorder that keeps them whole."""

from __future__ import annotations

from pathlib import Path
from threading import Event

import cv2
import numpy as np
from opencv_tools.image.encodings import find_encoding
from opencv_tools.recording import recorder as recorder_module
from opencv_tools.recording.naming import FileNames
from opencv_tools.recording.recorder import Recorder, RecordingError
from opencv_tools.recording.writers import encode_frame, FORMATS, UnwritableError
import pytest

ENCODINGS = ('mono8', 'mono16', 'bgr8', 'rgb8', 'bgra8', 'rgba8', 'bgr16', 'rgb16', 'rgba16',
             '8UC1', '8UC2', '8UC3', '8UC4', '16UC1', '16UC3', '16SC1', '32SC1', '32FC1', '32FC3',
             '64FC1', 'bayer_rggb8', 'yuv422')


@pytest.mark.parametrize(('template', 'name', 'suffix'), [
    ('{seq:06d}.png', '000042.png', '.png'), ('{seq}.JPG', '42.JPG', '.jpg'),
    ('a[{seq:d}]+b.tiff', 'a[42]+b.tiff', '.tiff'), ('{seq}_{seq:03d}.npy', '42_042.npy', '.npy'),
])
def test_names(template: str, name: str, suffix: str) -> None:
    names = FileNames(template)
    assert names.name(42) == name
    assert names.suffix == suffix
    assert names.next_seq([name, names.name(7), 'other.png', 'x42.png', '']) == 43
    assert names.next_seq([]) == 0


@pytest.mark.parametrize('template', [
    'x.png', '{}.png', '{other}.png', '{seq', '{seq:x}.png', '{seq:q}.png', '{seq:+d}.png',
    'a/{seq}.png', '../{seq}.png', '.{seq}.png', '{seq.real}.png', '{seq:,}.png', '{0}.png'])
def test_templates_that_are_refused(template: str) -> None:
    with pytest.raises(ValueError):
        FileNames(template)


def random_image(encoding: str) -> np.ndarray:
    found = find_encoding(encoding)
    shape = (9, 7) if found.channels == 1 else (9, 7, found.channels)
    return np.random.default_rng(4).integers(0, 127, shape).astype(found.dtype)


@pytest.mark.parametrize('suffix', FORMATS)
@pytest.mark.parametrize('encoding', ENCODINGS)
def test_a_format_keeps_a_frame_exactly_or_refuses_it(
        tmp_path: Path, encoding: str, suffix: str) -> None:
    image = random_image(encoding)
    path = tmp_path / f'file{suffix}'
    try:
        path.write_bytes(encode_frame(image, encoding, suffix))
    except UnwritableError as err:
        assert f'a {encoding} frame cannot be kept as {suffix}' in str(err)
        assert str(err).endswith('.npy')
        assert suffix != '.npy'
        return
    if suffix == '.npy':
        np.testing.assert_array_equal(np.load(path), image)
        return
    kept = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    expected = image[..., [2, 1, 0, 3][:image.shape[2]]] if encoding.startswith('rgb') else image
    assert kept.dtype == image.dtype and kept.shape == image.shape
    if suffix in ('.jpg', '.jpeg'):
        assert np.abs(kept.astype(int) - cv2.imdecode(cv2.imencode(suffix, expected)[1], -1)
                      ).max() == 0
    else:
        np.testing.assert_array_equal(kept, expected)


def test_big_endian_frames_are_kept_by_value() -> None:
    image = random_image('mono16') + 1000
    content = encode_frame(image.astype('>u2'), 'mono16', '.png')
    kept = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(kept, image)


def test_an_empty_frame_is_refused_with_its_size() -> None:
    with pytest.raises(UnwritableError, match=r'an empty frame, 0x5, cannot be kept as \.png'):
        encode_frame(np.zeros((5, 0, 3), np.uint8), 'bgr8', '.png')


def test_recorder_numbers_frames_in_the_order_they_came(tmp_path: Path) -> None:
    failures: list[str] = []
    recorder = Recorder(tmp_path / 'a' / 'b', FileNames('{seq:03d}.png'), failures.append)
    for number in range(50):
        assert recorder.put(np.full((20, 20), number, np.uint8), 'mono8')
    recorder.close()
    files = sorted((tmp_path / 'a' / 'b').iterdir())
    assert [file.name for file in files] == [f'{number:03d}.png' for number in range(50)]
    assert [cv2.imread(str(file), -1)[0, 0] for file in files] == list(range(50))
    assert (recorder.written, recorder.dropped, recorder.failed) == (50, 0, 0)
    assert not failures


def test_a_full_queue_drops_and_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    go_on = Event()

    def wait_and_encode(*args: object) -> bytes:
        go_on.wait(10)
        return encode_frame(*args)

    monkeypatch.setattr(recorder_module, 'encode_frame', wait_and_encode)
    recorder = Recorder(tmp_path, FileNames('{seq}.png'), pytest.fail, queue_size=3)
    taken = [recorder.put(np.zeros((2, 2), np.uint8), 'mono8') for _ in range(20)]
    go_on.set()
    recorder.close()
    assert recorder.written == sum(taken) < 20
    assert recorder.written + recorder.dropped == 20
    assert sorted(int(file.stem) for file in tmp_path.iterdir()) == list(range(recorder.written))


def test_trouble_is_reported_and_the_recorder_goes_on(tmp_path: Path) -> None:
    failures: list[str] = []
    folder = tmp_path / 'out'
    recorder = Recorder(folder, FileNames('{seq}.png'), failures.append)
    recorder.put(np.zeros((2, 2), np.float32), '32FC1')
    recorder.put(np.zeros((2, 2), np.uint8), 'mono8')
    recorder.close()
    assert (recorder.written, recorder.failed) == (1, 1)
    assert [file.name for file in folder.iterdir()] == ['1.png']
    assert failures == ['frame 0 was not written: a 32FC1 frame cannot be kept as .png; '
                        'set the extension of file_name to .tif or .tiff or .npy']


def test_a_folder_that_vanishes_is_reported_frame_by_frame(tmp_path: Path) -> None:
    failures: list[str] = []
    folder = tmp_path / 'out'
    recorder = Recorder(folder, FileNames('{seq}.png'), failures.append)
    folder.rmdir()
    recorder.put(np.zeros((2, 2), np.uint8), 'mono8')
    recorder.close()
    assert recorder.failed == 1
    assert 'No such file or directory' in failures[0]


def test_a_file_is_whole_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fill_the_disk(path: Path, content: bytes) -> None:
        with path.open('wb') as file:
            file.write(content[:10])
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(Path, 'write_bytes', fill_the_disk)
    failures: list[str] = []
    recorder = Recorder(tmp_path, FileNames('{seq}.png'), failures.append)
    recorder.put(np.zeros((2, 2), np.uint8), 'mono8')
    recorder.close()
    assert not list(tmp_path.iterdir())
    assert 'No space left on device' in failures[0]


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    with pytest.raises(RecordingError, match=r'output_dir .*/file/out cannot be used'):
        Recorder(tmp_path / 'file' / 'out', FileNames('{seq}.png'), pytest.fail)
