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

"""Settings of a video encoder, and the options of FFmpeg for them."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
import math
import os
from pathlib import Path
import re
from typing import Any

from opencv_tools.base.parameter_fields import parameter
from opencv_tools.base.remedies import installation
from opencv_tools.base.text import printable
from opencv_tools.image.errors import VideoError
from opencv_tools.video.packet import CODECS, ENCODED

# PyAV is imported in functions, because it is optional and its import is slow.

_ENCODERS = {'h264': 'libx264', 'h265': 'libx265'}
_NAME = re.compile('[a-z0-9][a-z0-9_-]{0,39}')
_PRESET = re.compile('[a-z0-9]{0,20}')
# Presets of libraries that write to standard error about others.
_X26X_PRESETS = ('ultrafast', 'superfast', 'veryfast', 'faster', 'fast', 'medium', 'slow',
                 'slower', 'veryslow')
_PRESETS = {'libx264': _X26X_PRESETS, 'libx265': _X26X_PRESETS}
_REFUSED = ('av1', 'libsvtav1')  # see ENCODED
_CODEC_REMEDY = f'give one of {", ".join(ENCODED)}, or an encoder of FFmpeg such as h264_nvenc'
_MAX_QUALITY = 51
_BIT_RATES = (10_000, 1_000_000_000)
_MAX_KEY_INTERVAL = 3600.0
_LEAST_BITS, _MOST_BITS = 1000, 2_000_000_000  # a second, of libx264
#: Frames per second that all encoders are told.
NOMINAL_RATE = 30
_BITS_A_PIXEL = 0.1  # of encoders without a constant quality
_ONE_THREAD_PIXELS = 1280 * 720  # up to this size more threads only cost more

# The sender selects key frames by time. The colours are those of opencv_tools.video.pixels.
_OPTIONS = {'g': '1000000', 'bf': '0', 'sc_threshold': '0', 'color_range': 'tv',
            **dict.fromkeys(('colorspace', 'color_primaries', 'color_trc'), 'smpte170m')}


@dataclass(frozen=True, kw_only=True)
class _Family:
    """The options of an encoder of FFmpeg, or of those whose names have an end in common."""

    end: str  # of the names
    preset: str = ''
    quality: str = ''  # option of the constant quality
    parameters: str = ''  # option with the parameters of the library
    level: str = ''  # option of the level, for which FFmpeg lowers the number of references
    always: dict[str, str]


_FAMILIES = (
    _Family(end='libx264', preset='superfast', quality='crf', level='level',
            always={'tune': 'zerolatency', 'forced-idr': '1'}),
    _Family(end='libx265', preset='superfast', quality='crf', parameters='x265-params', always={
        'tune': 'zerolatency', 'forced-idr': '1',
        'x265-params': 'log-level=none:info=0:scenecut=0:open-gop=0:repeat-headers=1:'
                       'frame-threads=1:pools='}),
    _Family(end='_nvenc', preset='p3', quality='cq', always={
        'tune': 'ull', 'zerolatency': '1', 'delay': '0', 'forced-idr': '1', 'rc': 'vbr'}),
    _Family(end='_qsv', preset='veryfast', quality='global_quality', always={
        'async_depth': '1', 'forced_idr': '1'}),
    _Family(end='', always={}),
)


def check_codec_name(text: str) -> None:
    """
    Check that a text may be the name of a codec or an encoder.

    :raises ValueError: it cannot be; the message is the remedy.
    """
    if not _is_codec_name(text):
        raise ValueError(_CODEC_REMEDY)


def _is_codec_name(text: str) -> bool:
    return bool(_NAME.fullmatch(text)) and text not in _REFUSED


def check_preset_name(text: str) -> None:
    """
    Check that a text may be the name of a preset.

    :raises ValueError: it cannot be; the message is the remedy.
    """
    if not _PRESET.fullmatch(text):
        raise ValueError("give one of the encoder, such as superfast, or '' for a fast one")


@dataclass(frozen=True, kw_only=True)
class VideoSettings:
    """
    Settings of a video encoder.

    :param codec: ``'h264'``, ``'h265'``, or an encoder of FFmpeg such as ``'h264_nvenc'``.
    :param quality: constant quality from 0 (best) to 51.
    :param bit_rate: mean bits per second, of which one second may have twice as many; 0 for a
        constant quality.
    :param key_interval: longest time between two key frames in seconds.
    :param preset: preset of the encoder; '' for a fast one.
    :raises VideoError: a value is invalid.
    """

    codec: str = parameter(
        'h264', 'Codec of the video topics: h264, h265, or an encoder of FFmpeg such as '
        'h264_nvenc', check=check_codec_name, changeable=True)
    quality: int = parameter(
        23, 'Quality of the video (CRF), from 0 (best) to 51', bounds=(0, _MAX_QUALITY),
        changeable=True)
    bit_rate: int = parameter(
        0, 'Largest number of bits per second of the video, from 10000; 0 for a constant quality',
        bounds=(0, _BIT_RATES[1]), changeable=True)
    key_interval: float = parameter(
        2.0, 'Seconds between two key frames of the video', bounds=(0.1, _MAX_KEY_INTERVAL),
        changeable=True)
    preset: str = parameter(
        '', 'Preset of the encoder of the video; empty for a fast one',
        check=check_preset_name, changeable=True)

    def __post_init__(self) -> None:
        """Check the values."""
        low, high = _BIT_RATES
        presets = _PRESETS.get(self.encoder_name, ())
        for name, is_valid, remedy in (
            ('codec', _is_codec_name(self.codec), _CODEC_REMEDY),
            ('quality', 0 <= self.quality <= _MAX_QUALITY, f'give 0 (best) to {_MAX_QUALITY}'),
            ('bit_rate', self.bit_rate == 0 or low <= self.bit_rate <= high,
             f'give {low} to {high} bits per second, or 0 for a constant quality'),
            ('key_interval', math.isfinite(self.key_interval)
             and 0 < self.key_interval <= _MAX_KEY_INTERVAL,
             f'give seconds above 0, up to {_MAX_KEY_INTERVAL:g}'),
            ('preset', _PRESET.fullmatch(self.preset) and (
                not presets or self.preset in ('', *presets)),
             f'give {" or ".join(presets) or "one of the encoder"}, or nothing for a fast one'),
        ):
            if not is_valid:
                raise VideoError(f'{name} is {printable(repr(getattr(self, name)), 80)}: {remedy}')

    @property
    def encoder_name(self) -> str:
        """Name of the encoder in FFmpeg."""
        return _ENCODERS.get(self.codec, self.codec)


def find_encoder(settings: VideoSettings) -> tuple[str, Any]:
    """
    Find the encoder of FFmpeg.

    :returns: one of ``CODECS``, and the ``av.Codec``.
    :raises VideoError: PyAV or the encoder is missing; the message includes the remedy.
    """
    codec_class, name = import_av().Codec, settings.encoder_name
    try:
        encoder = codec_class(name, 'w')
    except ValueError as err:
        raise VideoError(f"codec is '{settings.codec}': the installed PyAV has no such encoder; "
                         f'give one of {", ".join(ENCODED)}, or '
                         f'{installation("--upgrade av")}') from err
    for codec, decoder in zip(CODECS, ('h264', 'hevc', 'av1')):
        if codec_class(decoder, 'r').id == encoder.id:
            return codec, encoder
    raise VideoError(f"codec is '{settings.codec}', an encoder for other videos: give one for "
                     f'{", ".join(ENCODED)}')


def encoder_options(settings: VideoSettings, width: int, height: int, rate: float,
                    level: int) -> dict[str, str]:
    """
    Return the options of FFmpeg for an encoder without delay, which counts `NOMINAL_RATE`.

    So parameter sets do not depend on the rate of the frames, except for the level.

    :param width: width of the picture in pixels.
    :param height: height of the picture in pixels.
    :param rate: frames per second.
    :param level: level of the video, as in its parameter sets.
    """
    family = _family(settings)
    threads = min(4, os.cpu_count() or 1) if width * height > _ONE_THREAD_PIXELS else 1
    options = {**_OPTIONS, **family.always, 'threads': str(threads)}
    if family.parameters:
        options[family.parameters] += str(threads)
    if family.level:
        options[family.level] = str(level)
    if settings.preset or family.preset:
        options['preset'] = settings.preset or family.preset
    if family.quality and not settings.bit_rate:
        return {**options, family.quality: str(settings.quality), 'b': '0'}
    bits = settings.bit_rate or max(_BIT_RATES[0], int(_BITS_A_PIXEL * width * height * rate))
    told = str(min(_MOST_BITS, max(_LEAST_BITS, round(bits * NOMINAL_RATE / rate))))
    return {**options, 'b': told, 'maxrate': told, 'bufsize': str(bits)}


def _family(settings: VideoSettings) -> _Family:
    return next(row for row in _FAMILIES if settings.encoder_name.endswith(row.end))


def import_av() -> Any:
    """
    Import PyAV, without the log of FFmpeg.

    :raises VideoError: PyAV cannot be imported; the message includes the remedy.
    """
    try:
        import av
    except ImportError as err:
        raise VideoError(f'videos need PyAV, which cannot be imported ({err}); '
                         f'{installation("av")}') from err
    if major_version(av) < 14 and av.logging.get_level() != av.logging.PANIC:
        _silence_ffmpeg(av)
    return av


def major_version(av: Any) -> int:
    """Return the first number of the version of PyAV: 12 to 19 are tried."""
    return int(av.__version__.partition('.')[0])


def _silence_ffmpeg(av: Any) -> None:
    """
    Remove the log of FFmpeg that PyAV before 14 passes on to Python, whatever its level.

    A thread of FFmpeg that logs waits for the one that closes its file, and that one for the
    thread.
    """
    loaded = Path('/proc/self/maps').read_text(encoding='utf-8', errors='surrogateescape')
    libraries = re.findall(r'(/\S*/libavutil\S*)$', loaded, re.MULTILINE)
    for library in dict.fromkeys(libraries):  # OpenCV may have another one, which stays silent too
        ctypes.CDLL(library).av_log_set_callback(None)
    av.logging.set_level(av.logging.PANIC)
