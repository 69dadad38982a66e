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

"""Video files of other programs, judged by FFmpeg: number, times and pixels of the frames."""

from __future__ import annotations

import json
from pathlib import Path
import struct
import subprocess

import cv2
import numpy as np
from opencv_tools.capture.frame import FileSource
from opencv_tools.capture.source import open_source
import pytest
from waiting import LONGEST_SECONDS

SIZE, LONG = '176x144', '96x80'
# Pictures have half of the colours' resolution, and programs differ at sharp edges.
SOFT = 'gblur=sigma=3,noise=alls=4'
# Mean error in levels of 255. The conversions of colours differ by their rounding.
ERROR = 3.2
X264 = '-c:v libx264 -preset veryfast'
SMALL = '-pix_fmt yuv420p'
# Name of the file: options of ffmpeg for its encoder.
ENCODED = {
    'plain.mp4': X264, 'plain.mkv': X264, 'plain.avi': X264, 'plain.mov': X264, 'plain.flv': X264,
    'plain.ts': X264, 'plain.nut': X264, 'plain.mpg': '-c:v mpeg2video -q:v 3 -bf 2',
    'none.mp4': f'{X264} -bf 0', 'pyramid.mkv': f'{X264} -bf 5 -b_strategy 2 -x264-params '
    'b-pyramid=strict', 'open.mkv': f'{X264} -x264-params open-gop=1:keyint=8',
    'refresh.mkv': f'{X264} -x264-params intra-refresh=1:keyint=10 -bf 0',
    'slices.mp4': f'{X264} -slices 4', 'fragments.mp4': f'{X264} -g 10 -movflags '
    'frag_keyframe+empty_moov', 'fast.mp4': f'{X264} -movflags +faststart',
    'tff.mp4': f'{X264} -flags +ildct+ilme -x264opts tff=1',
    'bff.mkv': f'{X264} -flags +ildct+ilme -x264opts bff=1',
    'fake.mp4': f'{X264} -x264-params fake-interlaced=1',
    'tff.ts': '-c:v mpeg2video -flags +ildct+ilme -top 1 -q:v 3',
    'bff.mpg': '-c:v mpeg2video -flags +ildct+ilme -top 0 -q:v 3',
    'tff.avi': '-c:v mpeg4 -flags +ildct+ilme -q:v 3', 'dv.avi': '-c:v dvvideo -s 720x576',
    'dv.mov': '-c:v dvvideo -s 720x576 -pix_fmt yuv420p',
    'prores.mov': '-c:v prores_ks -flags +ildct -pix_fmt yuv422p10le',
    'av1.mp4': '-c:v libsvtav1 -preset 12', 'av1.mkv': '-c:v libaom-av1 -cpu-used 8 -b:v 300k',
    'av1.webm': '-c:v libaom-av1 -cpu-used 8 -lag-in-frames 0', 'av1.ivf': '-c:v libsvtav1 '
    '-preset 12', 'vp8.webm': '-c:v libvpx -b:v 600k', 'vp9.webm': '-c:v libvpx-vp9 -b:v 600k '
    '-deadline realtime', 'vp9.mp4': '-c:v libvpx-vp9 -b:v 600k -deadline realtime',
    'hevc.mp4': '-c:v libx265 -preset ultrafast -x265-params log-level=none',
    'hevc.mkv': '-c:v libx265 -preset fast -bf 3 -x265-params log-level=none',
    'hevc10.mkv': '-c:v libx265 -preset ultrafast -pix_fmt yuv420p10le -x265-params '
    'log-level=none', 'hevc12.mkv': '-c:v libx265 -preset ultrafast -pix_fmt yuv422p12le '
    '-x265-params log-level=none', 'high10.mp4': f'{X264} -pix_fmt yuv420p10le',
    'high422.mp4': f'{X264} -pix_fmt yuv422p', 'high444.mkv': f'{X264} -pix_fmt yuv444p',
    'rgb.mkv': '-c:v libx264rgb -pix_fmt rgb24', 'gray.mp4': f'{X264} -pix_fmt gray',
    'full.mp4': f'{X264} -pix_fmt yuvj420p',
    'mjpeg.avi': '-c:v mjpeg -q:v 2 -pix_fmt yuvj422p', 'mjpeg.mkv': '-c:v mjpeg -q:v 2 -pix_fmt '
    'yuvj420p', 'gray.avi': '-c:v mjpeg -q:v 2 -pix_fmt gray',
    'gray.mkv': '-c:v ffv1 -pix_fmt gray',
    'ffv1.mkv': '-c:v ffv1', 'huffyuv.avi': '-c:v huffyuv -pix_fmt yuv422p',
    'utvideo.avi': '-c:v utvideo', 'raw.avi': '-c:v rawvideo -pix_fmt bgr24', 'raw.nut':
    '-c:v rawvideo', 'png.mov': '-c:v png -pix_fmt rgb24', 'qtrle.mov': '-c:v qtrle -pix_fmt '
    'rgb24', 'mpeg4.avi': '-c:v mpeg4 -bf 2 -q:v 3', 'mpeg4.mp4': '-c:v mpeg4 -q:v 3',
    'theora.ogv': '-c:v libtheora -q:v 8', 'wmv.wmv': '-c:v wmv2 -q:v 3', 'gif.gif': '',
    'dnxhd.mov': '-c:v dnxhd -s 1280x720 -b:v 60M -pix_fmt yuv422p',
    'flv1.flv': '-c:v flv -q:v 3', 'bt709.mp4': f'{X264} -vf scale=out_color_matrix=bt709 '
    '-colorspace bt709', 'odd.mkv': f'{X264} -vf crop=175:143:0:0 -pix_fmt yuv444p',
    'pixels.mp4': f'{X264} -aspect 2:1', 'slow.mp4': f'{X264} -r 5', 'fast120.mkv':
    f'{X264} -r 120', 'rate.mp4': f'{X264} -r 24000/1001', 'vfr.mkv':
    f"{X264} -vf select='not(mod(n\\,3))+lt(n\\,5)' -fps_mode vfr",
    'vfr.mp4': f"{X264} -vf select='gt(mod(n\\,7)\\,2)' -fps_mode vfr -bf 2",
    'late.ts': f'{X264} -output_ts_offset 5000'}
# Name: the file that is copied, options before it and after it.
COPIED = {
    'edit.mp4': ('long.mp4', '-ss 0.5', ''), 'edit2.mp4': ('long.mp4', '-ss 1.21', ''),
    'edit.mov': ('long.mp4', '-ss 0.9', ''), 'cut.mkv': ('long.mp4', '-ss 0.5', ''),
    'cut.avi': ('long.mp4', '-ss 0.5', ''), 'short.mp4': ('long.mp4', '', '-t 1.3'),
    'before.mp4': ('long.mp4', '-itsoffset -0.4', ''),
    'after.mp4': ('long.mp4', '-itsoffset 0.7', ''), 'tail.ts': ('long.mp4', '-ss 0.6', ''),
    'sound.mp4': ('long.mp4', '-f lavfi -i sine', '-c:a aac -t 1')}
# The display matrix: what a step to the right and one down become.
TURNED = {
    'mirrored': (-1, 0, 0, 1), 'upside': (1, 0, 0, -1), 'half': (-1, 0, 0, -1),
    'right': (0, 1, -1, 0), 'left': (0, -1, 1, 0), 'main': (0, 1, 1, 0), 'anti': (0, -1, -1, 0)}
NAMES = [*ENCODED, *COPIED, *(f'{name}.mp4' for name in TURNED)]


def run(*command: object) -> bytes:
    finished = subprocess.run([str(word) for word in command], capture_output=True,
                              timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr.decode()
    return finished.stdout


def make(name: str, path: Path) -> Path:
    """Write the file of a row."""
    begin = ['ffmpeg', '-v', 'error', '-y']
    if name in ENCODED:
        depth = SMALL if '-pix_fmt' not in ENCODED[name] and name != 'gif.gif' else ''
        run(*begin, '-f', 'lavfi', '-i', f'testsrc2=size={SIZE}:rate=25:duration=1,{SOFT}',
            *f'{depth} {ENCODED[name]}'.replace("'", '').split(), path)
    elif name in COPIED:
        source, before, after = COPIED[name]
        origin = make(source, path.with_name('of_' + source)) if source in ENCODED else long(
            path.with_name(source))
        run(*begin, *before.split(), '-i', origin, '-c', 'copy', *after.split(), path)
    else:
        content = bytearray(make('plain.mp4', path.with_name('of_plain.mp4')).read_bytes())
        a, b, c, d = (65536 * number for number in TURNED[path.stem])
        struct.pack_into('>9i', content, content.index(b'tkhd') + 44, a, b, 0, c, d, 0, 0, 0,
                         1 << 30)
        path.write_bytes(content)
    return path


def long(path: Path) -> Path:
    run('ffmpeg', '-v', 'error', '-y', '-f', 'lavfi', '-i',
        f'testsrc2=size={LONG}:rate=25:duration=3,{SOFT}',
        *f'{SMALL} {X264} -g 20 -bf 3'.split(), path)
    return path


def judged(path: Path, *options: str) -> tuple[np.ndarray, list[float]]:
    """Return the pictures, all bytes in a row, and the times of the frames by ffmpeg."""
    pixels = run('ffmpeg', '-v', 'error', *options, '-i', path, '-map', '0:v:0', '-fps_mode',
                 'passthrough', '-vf', 'scale=flags=accurate_rnd+full_chroma_int+full_chroma_inp',
                 '-pix_fmt', 'bgr24', '-f', 'rawvideo', '-')
    found = json.loads(run(
        'ffprobe', '-v', 'error', '-select_streams', 'v:0', '-show_entries',
        'frame=best_effort_timestamp_time', '-of', 'json', path))['frames']
    return np.frombuffer(pixels, np.uint8), [
        float(frame.get('best_effort_timestamp_time', 'nan')) for frame in found]


def play(source: FileSource) -> tuple[list[np.ndarray], list[float]]:
    frames = list(iter(source.read, None))
    return [frame.image for frame in frames], [frame.position for frame in frames]


@pytest.mark.parametrize('name', NAMES)
def test_file_of_ffmpeg(tmp_path: Path, name: str) -> None:
    path = make(name, tmp_path / name)
    pixels, times = judged(path)
    source = open_source(str(path))
    for _ in range(2):
        images, positions = play(source)
        assert len(images) == len(times) > 4
        known = ~np.isnan(times)  # the last ones of an AVI with reordered frames have none
        assert np.diff(np.array(positions)[known]) == pytest.approx(
            np.diff(np.array(times)[known]), abs=2e-3)
        assert np.diff(positions).min() > 0
        if images[0].dtype != np.uint8:  # of depth
            continue
        expected = pixels.reshape(len(images), *images[0].shape)
        errors = [cv2.absdiff(one, other).mean() for one, other in zip(images, expected)]
        assert max(errors) < ERROR
        source.rewind()
    for _ in range(3):
        assert source.skip()
    frame = source.read()
    assert frame and np.array_equal(frame.image, images[3])
    source.close()
