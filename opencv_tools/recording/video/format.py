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
Videos as files of a recording, encoded or copied from packets of a publisher.

Packets of video are copied. All other frames are encoded: 16 bits in Matroska as FFV1, which is
lossless, and the others as H.264. A file has frames of one kind.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
import io
from pathlib import Path
from typing import Any

from opencv_tools.base.units import NANO
from opencv_tools.image.encodings import find_encoding, generic_encoding
from opencv_tools.image.errors import EncodingError, KeyFrameNeeded, VideoError
from opencv_tools.recording.errors import UnwritableError
from opencv_tools.recording.file_sink import CLOCK_JUMP_NS, FileFormat, OpenFile, Room
from opencv_tools.recording.frames import PacketFrame, RawFrame, ReceivedFrame
from opencv_tools.recording.image_encoder import (
    EncoderSettings, formats_for, LOSSLESS_VIDEO, to_eight_bits, without_loss)
from opencv_tools.recording.manifest import file_entry, ManifestEntry
from opencv_tools.recording.recorder import Prepared
from opencv_tools.recording.video.container import VideoFile, WrittenVideo
from opencv_tools.recording.video.writer import to_video_frame, VideoFrame, VideoWriter
from opencv_tools.video.packet import VideoPacket
from opencv_tools.video.parameter_sets import has_parameter_sets, parameter_sets

# PyAV is imported in functions, because the import is slow and most recordings are image files.

# Formats of FFmpeg that read packets without a container.
_RAW_FORMATS = {'h264': 'h264', 'h265': 'hevc', 'av1': 'obu'}
_DELIMITER = b'\x12\0'  # temporal delimiter of AV1, which containers and networks leave out


@dataclass(frozen=True, kw_only=True)
class PreparedPacket(Prepared):
    """
    A packet for a video.

    :param sets: its parameter sets; b'' if a video cannot begin with it.
    """

    packet: VideoPacket
    sets: bytes

    @property
    def stream_format(self) -> tuple[str, bytes] | None:
        """Codec and parameter sets, which contain the size; None if the packet has none."""
        return (self.packet.codec, self.sets) if self.sets else None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.packet.width, self.packet.height

    @property
    def codec(self) -> str:
        """Name of the codec."""
        return self.packet.codec


def prepare_packet(packet: VideoPacket) -> PreparedPacket:
    """
    Read the parameter sets of a packet.

    :raises VideoError: the packet is empty or damaged.
    """
    if not packet.data:
        raise VideoError(f'a packet of {packet.codec} is empty')
    is_first = packet.is_key and has_parameter_sets(packet.codec, packet.data)
    return PreparedPacket(
        packet=packet, sets=parameter_sets(packet.codec, packet.data) if is_first else b'')


class CopiedStream(WrittenVideo[PreparedPacket]):
    """A stream of packets as they are; see `WrittenVideo`."""

    def __init__(self, first: PreparedPacket) -> None:
        """
        Describe a stream.

        :param first: its first packet, which has parameter sets.
        """
        self.stream_format = first.packet.codec, first.sets
        width, height = first.size
        self.failure = f'{width}x{height} {first.packet.codec} video cannot be stored'
        self._first = first
        self._ticks = 1
        self._stream: Any = None

    def open(self, container: Any, ticks: int) -> None:  # noqa: A003
        """
        Add a stream with the parameter sets, which FFmpeg converts to avcC, hvcC or av1C.

        :raises VideoError: FFmpeg finds no video in the first packet.
        """
        import av
        self._ticks = ticks
        packet = self._first.packet
        damage = f'{self.failure}: its first packet is damaged'
        begin = _DELIMITER * (packet.codec == 'av1' and not packet.data.startswith(_DELIMITER))
        try:
            opened = av.open(io.BytesIO(begin + packet.data), format=_RAW_FORMATS[packet.codec],
                             options={'skip_frame': 'all'})  # nothing is decoded
        except av.error.FFmpegError as err:
            raise VideoError(f'{damage} ({err.strerror})') from err
        with opened as raw:
            if not raw.streams.video:
                raise VideoError(damage)
            template = raw.streams.video[0]
            if hasattr(container, 'add_stream_from_template'):
                self._stream = container.add_stream_from_template(template, opaque=True)
                self._stream.time_base = Fraction(1, ticks)
            else:  # PyAV 12
                self._stream = container.add_stream(template=template)
        self._stream.codec_context.extradata = self._first.sets

    def packets(self, prepared: PreparedPacket | None, pts: int) -> Iterable[Any]:
        """Return the packet of a frame."""
        import av
        if prepared is None:
            return ()
        packet = av.Packet(prepared.packet.data)
        packet.stream, packet.time_base = self._stream, Fraction(1, self._ticks)
        packet.pts = packet.dts = pts
        packet.is_keyframe = prepared.packet.is_key
        return (packet,)


# Shortest time of a file of packets whose publisher changes the size again.
_SHORTEST_NS = NANO
# Changes after which files may no longer be short, and which are logged.
_MANY_CHANGES = 3
_SMALL_STEP_NS = NANO // 1000


# One frame of a video.
_Prepared = VideoFrame | PreparedPacket


class VideoFormat(FileFormat[VideoFile[Any], _Prepared]):
    """Write frames to videos, which always play."""

    def __init__(self, settings: EncoderSettings) -> None:
        self._settings = settings
        self._last_format: tuple[tuple[int, int], str, object] | None = None  # of the last file
        self._changes = 0  # of the format
        self._files = 0
        self._has_warned_of_stamps = False
        self._jumps = 0  # steps of the stamps that began another video
        #: Publisher and number of the last packet of the video, which the next one follows.
        self._last: tuple[bytes, int] | None = None

    def prepare(self, frame: ReceivedFrame) -> _Prepared:
        """Convert a frame for the encoder, or read a packet; see `FileFormat`."""
        if isinstance(frame, PacketFrame):
            return prepare_packet(frame.packet)
        raw, settings = frame.decode(), self._settings
        image, name = raw.image, raw.metadata.encoding
        if settings.lossy:
            image, reduced = to_eight_bits(image, find_encoding(name), settings)
            name = reduced.name
        try:
            return to_video_frame(image, name, settings.suffix, settings.to_color)
        except VideoError as err:
            other = raw.metadata.encoding if settings.suffix != LOSSLESS_VIDEO else ''
            raise UnwritableError(f'{err}; set the extension of file_name to '
                                  f'{formats_for(_image_type(raw), other)}'
                                  + without_loss(find_encoding(name), settings)) from err

    def create(self, path: Path, frame: ReceivedFrame, prepared: _Prepared, room: Room,
               ) -> VideoFile[Any]:
        """Create a video with the size and format of a frame; see `FileFormat`."""
        video: VideoFile[Any] = (
            VideoFile(path, CopiedStream(prepared), frame.time_ns, room)
            if isinstance(prepared, PreparedPacket) else
            VideoWriter(path, prepared, frame.time_ns, self._settings.crf, room))
        self._count_changes(path.name, prepared)  # not before: another name may be tried
        self._files += 1
        return video

    def entry(self, seq: int, name: str, frame: ReceivedFrame, prepared: _Prepared,
              ) -> ManifestEntry:
        """Return the manifest entry of a video; see `FileFormat`."""
        return file_entry(seq, name, frame, prepared.codec, prepared.size)

    def write(self, file: OpenFile[VideoFile[Any]], frame: ReceivedFrame, prepared: _Prepared,
              ) -> bool:
        """Encode a frame, or copy a packet; see `FileFormat`."""
        file.uses_arrivals |= self._jumps > 1
        time_ns = file.time_ns(frame)
        is_written = file.writer.write(prepared, time_ns)
        if is_written:
            file.last_time_ns, file.last_arrival_ns = time_ns, frame.arrival_ns
            file.last_stamp_ns = frame.metadata.stamp_ns
            if isinstance(frame, PacketFrame):
                self._last = frame.publisher, frame.number
        return is_written

    def continues(self, file: OpenFile[VideoFile[Any]], frame: ReceivedFrame, prepared: _Prepared,
                  ) -> bool:
        """Return whether a frame fits a video; see `FileFormat`."""
        time_ns = file.time_ns(frame)
        fits = file.writer.fits(prepared, time_ns)
        if file.last_stamp_ns and frame.metadata.stamp_ns:
            self._check_stamp(file, frame, time_ns, fits)
        if fits or (file.uses_arrivals and file.writer.fits(prepared, file.time_ns(frame))):
            return True
        if (isinstance(prepared, PreparedPacket) and prepared.sets and self._files > _MANY_CHANGES
                and 0 <= frame.arrival_ns - file.began_ns < _SHORTEST_NS):
            self._last = None
            raise KeyFrameNeeded('the size or the codec of the video changed within a second')
        return False

    def can_begin(self, prepared: _Prepared) -> bool:
        """Return whether a video can begin with a frame; see `FileFormat`."""
        return not isinstance(prepared, PreparedPacket) or bool(prepared.sets)

    def check(self, file: OpenFile[VideoFile[Any]] | None, frame: ReceivedFrame,
              prepared: _Prepared) -> None:
        """Check that a packet does not need others that are missing; see `FileFormat`."""
        if not isinstance(frame, PacketFrame) or not isinstance(prepared, PreparedPacket):
            return
        continues = file is not None and isinstance(file.writer.stream, CopiedStream) and (
            frame.packet.is_key or self._is_next(frame))
        if not (prepared.sets or continues):
            raise KeyFrameNeeded(
                f'a packet of {frame.packet.codec} needs earlier packets, which are missing in '
                'the video')

    def _check_stamp(
        self, file: OpenFile[VideoFile[Any]], frame: ReceivedFrame, time_ns: int, fits: bool,
    ) -> None:
        """
        Warn once of stamps that step back, stand still or step forward.

        Only one step of each recording begins another video. Stamps of two clocks would begin one
        for each frame.

        :param fits: whether a frame with this time can continue the video.
        """
        step = frame.metadata.stamp_ns - file.last_stamp_ns
        ahead = step - max(0, frame.arrival_ns - file.last_arrival_ns)
        is_jump = step < -CLOCK_JUMP_NS or (
            ahead > CLOCK_JUMP_NS and (not fits or self._jumps > 0))
        is_used = time_ns == frame.metadata.stamp_ns
        if file.uses_arrivals or not (is_jump or ahead > CLOCK_JUMP_NS or not is_used):
            return
        self._jumps += is_jump
        file.uses_arrivals = self._jumps > 1
        what = (f'step back by {-step / NANO:.3g} s' if step < -_SMALL_STEP_NS else
                f'step forward by {ahead / NANO:.3g} s' if ahead > CLOCK_JUMP_NS else
                'stand still')
        if file.uses_arrivals or not self._has_warned_of_stamps:
            self.warning = f'the stamps of the frames {what}; ' + (
                'the video goes on with the times of arrival' if file.uses_arrivals else
                'another video begins' if is_jump else
                'the video has this gap' if is_used else
                'the video goes on with the times of arrival')
        self._has_warned_of_stamps = True

    def _is_next(self, frame: PacketFrame) -> bool:
        """Return whether a packet follows the last one; without numbers none is missing."""
        publisher, number = self._last or (None, 0)
        return frame.publisher == publisher and frame.number in (0, number + 1)

    def _count_changes(self, name: str, prepared: _Prepared) -> None:
        """Warn of frames whose change begins another video, a few times."""
        size, found = prepared.size, (prepared.size, prepared.codec, prepared.stream_format)
        last, self._last_format = self._last_format, found
        if last in (None, found):
            return
        self._changes += 1
        (width, height), codec, _ = last
        what = (f'the size of the frames changed from {width}x{height} to {size[0]}x{size[1]}'
                if size != last[0] else
                f'their codec changed from {codec} to {prepared.codec}'
                if codec != prepared.codec else
                'the publisher of the video has opened its encoder anew, as after a change of its '
                'settings'
                if isinstance(prepared, PreparedPacket) else 'the encoding of the frames changed')
        if self._changes < _MANY_CHANGES:
            self.warning = f'another video, {name}, begins: {what}'
        elif self._changes == _MANY_CHANGES:
            self.warning = (
                f'{what}, which is change {self._changes}, and each of them begins another video; '
                'record images, or one publisher with one size and constant settings')


def _image_type(frame: RawFrame) -> str:
    """Return the type of the image of a frame, for the list of formats that can hold it."""
    encoding = frame.metadata.encoding
    try:
        has_channels = find_encoding(encoding).kind in ('generic', 'color')
        return generic_encoding(frame.image).name if has_channels else encoding
    except EncodingError:
        return encoding
