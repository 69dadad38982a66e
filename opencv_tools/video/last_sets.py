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

"""The parameter sets of a stream, for key frames that lack them."""

from __future__ import annotations

from opencv_tools.video.bit_stream import START_CODE
from opencv_tools.video.parameter_sets import (
    has_parameter_sets, newest_sets, parameter_sets)

# First byte of access unit delimiters, which stay the first unit.
_DELIMITERS = {'h264': b'\x09', 'h265': b'\x46'}


class LastSets:
    """The last parameter sets of a stream."""

    def __init__(self, codec: str, sets: bytes = b'') -> None:
        """
        Begin with the parameter sets of a container.

        :param codec: one of ``CODECS``.
        :param sets: parameter sets with start codes; b'' if there are none yet.
        """
        #: Codec of the stream.
        self.codec = codec
        self._sets = sets

    def keep(self, data: bytes) -> bool:
        """
        Keep parameter sets that come without a picture, which may be in several packets.

        :returns: whether the packet has parameter sets.
        :raises VideoError: the packet is damaged.
        """
        found = parameter_sets(self.codec, data)
        if found:
            self._sets = newest_sets(self.codec, self._sets, found)
        return bool(found)

    def complete(self, data: bytes) -> bytes | None:
        """
        Return a key frame with its parameter sets.

        :param data: content of the key frame. Its own parameter sets are kept for later ones.
        :returns: the data, with the last sets if they have none; None if there are no sets yet.
        :raises VideoError: the packet is damaged.
        """
        if has_parameter_sets(self.codec, data):
            self._sets = parameter_sets(self.codec, data)
            return data
        self.keep(data)
        if not has_parameter_sets(self.codec, self._sets):
            return None
        prefix = START_CODE[1:]
        begin = data.find(prefix) + len(prefix)
        if data[begin:begin + 1] != _DELIMITERS.get(self.codec):
            return self._sets + data
        end = data.find(prefix, begin)
        end -= data[end - 1] == 0
        return data[:end] + self._sets + data[end:]
