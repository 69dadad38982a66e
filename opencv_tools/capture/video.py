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

"""Video files as a source, decoded by the FFmpeg backend of OpenCV."""

from __future__ import annotations

from collections.abc import Sequence
import math
from pathlib import Path
import re
import socket
from typing import Literal
from urllib.parse import quote, urlsplit

from opencv_tools.base.text import enumerated, MAX_PATH, printable, without_password
from opencv_tools.capture.errors import BrokenFrameError, CaptureError
from opencv_tools.capture.frame import CapturedFrame, MAX_RATE
from opencv_tools.opencv import cv2

# Containers with an index of their frames. For other containers OpenCV estimates the number.
_LISTED_SUFFIXES = frozenset(('.mp4', '.m4v', '.mov', '.avi'))
# A Matroska file begins with the first element. The second one has the size of all that follows.
_EBML, _SEGMENT, _HEAD_BYTES = b'\x1a\x45\xdf\xa3', b'\x18\x53\x80\x67', 256

# URL schemes that FFmpeg opens over TCP, with their default ports.
_PORTS = {'http': 80, 'https': 443, 'rtsp': 554, 'rtsps': 322, 'rtmp': 1935, 'rtmps': 443,
          'ftp': 21, 'tcp': 0}

# Schemes that need a host; udp://@:5000 and srt://:9000 listen.
_WITH_HOST = ('http', 'https', 'rtsp', 'rtsps', 'rtmp', 'rtmps', 'ftp')
# Timeout of the connection to each address of the server.
_ANSWER_SECONDS = 2.0

# Characters that a user name or password may have as they are, and those that are encoded already.
_ALLOWED = "!$&'()*+,;=:@"
_ENCODED = re.compile('%[0-9A-Fa-f]{2}')


class VideoSource:
    """A video file. Each frame has its time in the file."""

    live: Literal[False] = False
    warnings: Sequence[str] = ()

    def __init__(self, location: str, capture: cv2.VideoCapture) -> None:
        """
        Wrap an open video.

        :param location: path of the file, or its URL on a web server.
        :param capture: the open video, as ``open_video`` returns it.
        """
        self._location = location
        self.name = without_password(location)
        self._capture = capture
        self.rate = video_rate(capture)
        self.description = describe_video(capture)
        self.count = frame_count(capture)
        self._number = 0
        self._is_checked = False

    def skip(self) -> bool:
        if self._capture.grab():
            self._number += 1
            return True
        if not self._is_checked:
            self._is_checked = True
            check_end(self._location, self._number, self.count)
        return False

    def read(self) -> CapturedFrame | None:
        if not self.skip():
            return None
        position = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        # OpenCV also returns 0 for an unknown time: for the last frames of an AVI with reordered
        # frames (B-frames), and with OpenCV 4.6 for those of any file with reordered frames.
        known = math.isfinite(position) and (position or self._number == 1)
        decoded, image = self._capture.retrieve()
        if not decoded:
            raise BrokenFrameError(f'frame {self._number - 1} of {self.name} cannot be decoded')
        return CapturedFrame(image, 'bgr8', position=position if known else None)

    def rewind(self) -> None:
        # Reopening is exact for every container; seeking to frame 0 is not.
        self._capture.release()
        self._capture = open_video(self._location)
        self._number = 0

    def close(self) -> None:
        self._capture.release()


def check_end(location: str, number: int, count: int) -> None:
    """
    Check that a video has the frames of its index, or the bytes of its header, if it has these.

    :param location: path of the file, or its URL.
    :param number: number of frames until its end.
    :param count: number of frames by OpenCV.
    :raises BrokenFrameError: it has fewer.
    """
    path, rest = Path(location), ''
    if path.suffix.lower() in _LISTED_SUFFIXES:
        rest = f' of its {count} frames' if number < count else ''
    elif path.is_file():
        size, declared = path.stat().st_size, _declared_bytes(path)
        rest = f' frames, with {size} of its {declared} bytes' if size < declared else ''
    if rest:
        raise BrokenFrameError(
            f'{without_password(location)} is damaged: it ends after {number}{rest}')


def _declared_bytes(path: Path) -> int:
    """Return the size of a Matroska file by its header; 0 if it is unknown."""
    with path.open('rb') as file:
        head = file.read(_HEAD_BYTES)
    begin = head.find(_SEGMENT) + len(_SEGMENT)
    if not head.startswith(_EBML) or begin < len(_SEGMENT) or begin + 8 > len(head):
        return 0
    # The zeros at the begin of a number are its bytes after the first; ones only mean unknown.
    length = 9 - head[begin].bit_length()
    number, unknown = int.from_bytes(head[begin:begin + length], 'big'), (1 << 7 * length) - 1
    return 0 if number & unknown == unknown else begin + length + (number & unknown)


def open_video(location: str, *options: int) -> cv2.VideoCapture:
    """
    Open a video file or a stream.

    :param location: path or URL.
    :param options: ``cv2.CAP_PROP_*`` properties for opening, each followed by its value.
    :returns: the open video.
    :raises CaptureError: the location cannot be opened as a video.
    """
    capture = cv2.VideoCapture(location, cv2.CAP_FFMPEG, options)
    if not capture.isOpened():
        raise CaptureError(describe_failure(location) if '://' in location else
                           f'{printable(location, MAX_PATH)} cannot be opened as a video: '
                           'it is damaged or not a video')
    return capture


def video_rate(capture: cv2.VideoCapture) -> float:
    """Return the frames per second in the header of a video; 0.0 if the value is implausible."""
    rate = capture.get(cv2.CAP_PROP_FPS)
    return rate if math.isfinite(rate) and 0 < rate <= MAX_RATE else 0.0


def frame_count(capture: cv2.VideoCapture) -> int:
    """Return the number of frames of a video file; 0 for a stream."""
    return max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))


def describe_video(capture: cv2.VideoCapture) -> str:
    """Return the size and rate of a video as text, such as ``640x480 at 30 Hz``."""
    width, height = (int(capture.get(prop)) for prop in (
        cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    return f'{width}x{height} at {video_rate(capture):g} Hz'


def check_url(url: str) -> None:
    """
    Check that the host and the port of a URL can be read.

    :raises ValueError: they cannot. The message has the characters of the user name and password
        to encode, and no other part of the URL, because each may be a part of the password.
    """
    remedy = 'write HOST:PORT or [ADDRESS]:PORT, with a port from 0 to 65535'
    try:
        parts = urlsplit(url)
        _ = parts.port
        host = parts.hostname or ''
        if (host or parts.scheme.lower() not in _WITH_HOST) and ' ' not in host:
            return
    except ValueError:  # it quotes a part of the URL
        pass
    user, at, _ = url.partition('://')[2].rpartition('@')
    odd = sorted(letter for letter in {*_ENCODED.sub('', user)}
                 if quote(letter, _ALLOWED, errors='replace') != letter)
    if at and odd:
        written = [f"'{printable(letter)}' as {quote(letter, '', errors='replace')}"
                   for letter in odd]
        remedy = f'write {enumerated(written)} in the user name and the password'
    raise ValueError(f'the host and the port of this URL cannot be read: {remedy}')


def describe_failure(url: str) -> str:
    """
    Return the reason why a stream could not be opened.

    Connects to the server of the stream once, to find out whether the server is reachable.

    :returns: a sentence with the host, the port and the reason, as far as they are known; without
        the password of the URL.
    """
    shown = without_password(url)
    unknown = f'{shown} cannot be opened as a video: it is unreachable or sends no video'
    try:
        check_url(url)
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port or _PORTS.get(parts.scheme)
        if '@' in parts.path + parts.query + parts.fragment:  # the host may be a part of the user
            return (f'{unknown}; write / ? # of a user name or password as %2F %3F %23')
        if parts.scheme not in _PORTS or not host or not port:
            return unknown
        socket.create_connection((host, port), _ANSWER_SECONDS).close()
    except UnicodeError:  # it quotes the host
        return f'{shown} is not a URL: its host is not a name or an address'
    except ValueError as err:
        return f'{shown} is not a URL: {err}'
    except TimeoutError:
        reason = f'no answer in {_ANSWER_SECONDS:g} s'
    except OSError as err:
        reason = err.strerror or str(err)
    else:
        return (f'{shown} cannot be opened as a video: {printable(host)} port {port} is '
                'reachable, but sends no readable video')
    return f'{shown} is not reachable: {printable(host)} port {port}: {reason}'
