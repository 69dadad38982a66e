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

"""A process that sends a video with PyAV, to the first client or to a listening one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import pickle
import socket
import subprocess
import sys

import numpy as np

_SCRIPT = """
from fractions import Fraction
import pickle, sys, time
import av
url, form, codec, options, pause, rounds, contents = pickle.load(sys.stdin.buffer)
while True:
    try:
        container = av.open(url, "w", format=form)
        stream = container.add_stream("libx264" if codec == "packets" else codec, rate=30,
                                      options=options)
        stream.width, stream.height, stream.pix_fmt = 160, 120, "yuv420p"
        if codec == "packets" and form != "mpegts":
            stream.codec_context.extradata = contents[0]
        container.start_encoding()
        break
    except OSError:  # the client does not listen yet
        time.sleep(0.05)
with container:
    for number in range(rounds * len(contents)):
        content = contents[number % len(contents)]
        if codec == "packets":
            packet = av.Packet(content)
            packet.stream, packet.time_base = stream, Fraction(1, 30)
            packet.pts = packet.dts = number
            container.mux(packet)
        else:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(content, format="bgr24")))
        time.sleep(pause)
    if codec != "packets":
        container.mux(stream.encode())
"""


def free_port() -> int:
    """Return a TCP port that nobody uses."""
    with socket.socket() as free:
        free.bind(('127.0.0.1', 0))
        return int(free.getsockname()[1])


class VideoServer:
    """Send packets of H.264 unchanged, or images with an encoder."""

    def __init__(
        self, contents: Sequence[bytes] | Sequence[np.ndarray], *, form: str = 'mpegts',
        codec: str = 'packets', options: dict[str, str] | None = None, pause: float = 0.0,
        rounds: int = 1, scheme: str = 'tcp',
    ) -> None:
        """
        Start the process.

        :param contents: packets, or images of 160x120 pixels.
        :param form: format of FFmpeg.
        :param codec: encoder of the images; ``packets`` for packets.
        :param options: options of the encoder.
        :param pause: seconds after each picture.
        :param rounds: how often the pictures are sent.
        :param scheme: with ``tcp`` the process listens, otherwise the client does.
        """
        #: URL for the client.
        self.url = f'{scheme}://127.0.0.1:{free_port()}' + '/live' * (scheme != 'tcp')
        url = self.url + '?listen=1&listen_timeout=600000' * (scheme == 'tcp')
        self.process = subprocess.Popen([sys.executable, '-c', _SCRIPT], stdin=subprocess.PIPE)
        assert self.process.stdin
        with self.process.stdin as pipe:
            pickle.dump((url, form, codec, options or {}, pause, rounds, [*contents]), pipe)

    def wait_until_it_listens(self) -> bool:
        """Return whether the process listens now."""
        port = int(self.url.rpartition(':')[2])
        assert self.process.poll() is None
        return f':{port:04X} 00000000:0000 0A' in Path('/proc/net/tcp').read_text()

    def close(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.wait()
