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

"""Fast DDS and malloc set up for frames, unless the user has set them up otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, ExitStack, suppress
import ctypes
from dataclasses import dataclass
import math
import os
from tempfile import NamedTemporaryFile

from opencv_tools.ros.other_users import find_other_user
from opencv_tools.ros.shared_memory import (
    free_bytes, is_writable, remove_dead_segments, SHARED_MEMORY,
)

#: What ``--help`` says of it.
HELP = ('environment:\n'
        '  OPENCV_TOOLS_TRANSPORT=default  leave Fast DDS and malloc as they are, to compare, or\n'
        '                                  where a profile of your own comes another way than by\n'
        '                                  the variables of Fast DDS; large frames may be lost')

_MB = 1 << 20
# Frames that lie in shared memory at the same time, and those without which some are lost.
_FRAMES = 8
_LEAST_FRAMES = 3
_LEAST_SEGMENT = 16 * _MB
_LARGEST_SEGMENT = 256 * _MB
_USUAL_SEGMENT = _MB // 2  # what Fast DDS takes for small messages

# A reader's port lists the pieces that wait for it, and more are thrown away: Fast DDS's own 512
# are 1.35 frames of 3840x2160. They are 65482 bytes, as UDP takes no more, and fewer here.
_PIECE = 65_000
_LEAST_PIECES = 512
_MOST_PIECES = 8192
_UNKNOWN_PIECES = 4096  # eight frames of 3840x2160 and some more, of whoever publishes them
_DESCRIPTOR_BYTES = 20  # that the port keeps of each piece
_PORTS_OF_ROOM = 1 / 16  # each participant has two or three ports

# Asked of the kernel for what comes over UDP; it gives what net.core.rmem_max allows. As much to
# send from would let a slow link choke on what is sent again.
_SOCKET_BYTES = 4 * _MB

# How often subscribers are asked what they miss. Fast DDS's own 3 s is how long a lost frame, or
# the confirmation of the last one, may take.
_HEARTBEAT_NANOSECONDS = 100_000_000

# Parameters of mallopt(3), and what keeps glibc from giving the memory of a frame back to the
# kernel, which gives it out again page by page.
_M_TRIM_THRESHOLD = -1
_M_TOP_PAD = -2
_M_MMAP_THRESHOLD = -3
_KEPT_BYTES = 256 * _MB
_PADDING_BYTES = 64 * _MB

# What a user may have set; then nothing is touched.
_USER_VARIABLES = (
    'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTDDS_BUILTIN_TRANSPORTS')
_USER_FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')

_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">{participant}
  <data_writer profile_name="opencv_tools_writer" is_default_profile="true">
    <times>
      <heartbeatPeriod>
        <sec>0</sec>
        <nanosec>{heartbeat}</nanosec>
      </heartbeatPeriod>
    </times>
  </data_writer>
</profiles>
"""
_PARTICIPANT = """
  <transport_descriptors>{descriptors}
  </transport_descriptors>
  <participant profile_name="opencv_tools" is_default_profile="true">
    <rtps>
      <userTransports>{names}
      </userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
    </rtps>
  </participant>"""
_NAME = """
        <transport_id>{name}</transport_id>"""
_DESCRIPTOR = """
    <transport_descriptor>
      <transport_id>{name}</transport_id>
      <type>{name}</type>{options}
    </transport_descriptor>"""
_OPTION = """
      <{name}>{value}</{name}>"""


# Where rmw_fastrtps adds a transport of its own, Fast DDS tries and prints lines of its own.
_NO_SHARED_MEMORY = (
    f'{SHARED_MEMORY} cannot be written to, so that frames go over UDP and may come late; errors '
    'of RTPS_TRANSPORT_SHM below say the same')

_OTHER_USER = ('user {user} runs nodes here too, and Fast DDS has no shared memory between users: '
               '{what}; run all nodes as one user')
_SLOWLY = 'frames go over UDP and may come late'
_NOT_AT_ALL = 'no frame goes between those nodes and this one while the discovery is LOCALHOST'


@dataclass(frozen=True)
class Transport:
    """
    How frames go to the subscribers on this machine.

    :param remark: what was set up and why, in a sentence.
    :param segment: bytes of shared memory for frames, 0 where they go over UDP; None where that
        is the user's choice, or nothing would help.
    :param room: bytes of shared memory that were free.
    :param warning: what is wrong whatever the size of the frames, in a sentence; '' for nothing.
    """

    remark: str
    segment: int | None = None
    room: int = 0
    warning: str = ''

    def misfit(self, frame_bytes: int) -> str:
        """
        Say why frames will be late or lost, and what helps.

        :param frame_bytes: of each frame.
        :returns: a sentence, '' where they fit.
        """
        if self.segment is None or self.segment >= _LEAST_FRAMES * frame_bytes:
            return ''
        wanted = 2 * _wanted_segment(frame_bytes)
        if self.room >= wanted:
            return (f'the shared memory of {_in_mb(self.segment)} that was reserved at the start '
                    f'is small for frames of {_in_mb(frame_bytes)}, which may come late or not at '
                    'all: start the node with the size that it publishes')
        return (f'{SHARED_MEMORY} had {_in_mb(self.room)} free, which is little for frames of '
                f'{_in_mb(frame_bytes)}: they may come late or not at all; give it '
                f'{_in_mb(wanted)}, in Docker with --shm-size={math.ceil(wanted / _MB)}m or '
                '--ipc=host')


UNTOUCHED = Transport('nothing was set up')


@contextmanager
def transport_for_frames(frame_bytes: int) -> Iterator[Transport]:
    """
    Give a process a transport that holds several frames, quick heartbeats, and kept memory.

    Fast DDS's own segment of 512 KB is smaller than one frame, so that its pieces do not fit, and
    frames are lost or late; so are its sockets. The profile counts for a process's first node,
    which has to be made inside the block.
    Nothing is touched when the user has configured Fast DDS, uses another middleware or has set
    ``OPENCV_TOOLS_TRANSPORT=default``.

    :param frame_bytes: of each frame that will be published, as far as it is known; 0 for none.
    :returns: what was set up.
    """
    reason = _user_choice()
    if reason:
        yield Transport(f'Fast DDS and malloc are left as they are: {reason}')
        return
    _keep_memory()
    removed = remove_dead_segments()
    room = free_bytes()
    other_user = find_other_user()
    if other_user and not _is_local():  # there rmw_fastrtps adds shared memory of its own
        with _profile(_describe_profile(0, 0)):
            yield Transport('UDP for frames, because of the other user', room=room,
                            warning=_OTHER_USER.format(user=other_user, what=_SLOWLY))
        return
    segment = _affordable_segment(frame_bytes, room)
    with _profile(_describe_profile(segment, _affordable_pieces(frame_bytes, room))):
        yield Transport(
            f'{_in_mb(segment)} of shared memory beside UDP for frames of {_in_mb(frame_bytes)}, '
            f'as {SHARED_MEMORY} has {_in_mb(room)} free; {removed} dead segments removed; '
            'malloc keeps the memory of frames', segment, room,
            _NO_SHARED_MEMORY if not is_writable() else
            _OTHER_USER.format(user=other_user, what=_NOT_AT_ALL) if other_user else '')


def _user_choice() -> str:
    """Say why the transport is not ours to choose, '' when it is."""
    if os.environ.get('OPENCV_TOOLS_TRANSPORT') == 'default':
        return 'OPENCV_TOOLS_TRANSPORT is default'
    middleware = os.environ.get('RMW_IMPLEMENTATION', 'rmw_fastrtps_cpp')
    if middleware != 'rmw_fastrtps_cpp':
        return f'RMW_IMPLEMENTATION is {middleware}'
    for variable in _USER_VARIABLES:
        if os.environ.get(variable):
            return f'{variable} is set'
    return next((f'there is {name}' for name in _USER_FILES
                 if os.access(name, os.F_OK)), '')  # unlike Path.exists() this never raises


def _wanted_segment(frame_bytes: int) -> int:
    if not frame_bytes:
        return _USUAL_SEGMENT
    return max(min(max(_FRAMES * frame_bytes, _LEAST_SEGMENT), _LARGEST_SEGMENT),
               _LEAST_FRAMES * frame_bytes)


def _affordable_segment(frame_bytes: int, room: int) -> int:
    """Give the segment's size: at most half of what is free, 0 when too little would fit."""
    segment = min(_wanted_segment(frame_bytes), room // 2)
    return segment if segment >= max(_LEAST_FRAMES * frame_bytes, _USUAL_SEGMENT) else 0


def _affordable_pieces(frame_bytes: int, room: int) -> int:
    """Return how many pieces may wait for this process: those of all frames in the segment."""
    wanted = math.ceil(_FRAMES * frame_bytes / _PIECE) if frame_bytes else _UNKNOWN_PIECES
    affordable = int(room * _PORTS_OF_ROOM) // _DESCRIPTOR_BYTES
    return max(_LEAST_PIECES, min(wanted, affordable, _MOST_PIECES))


def _describe_profile(segment: int, pieces: int) -> str:
    """Write the profile; a segment that is too small for frames is slower than UDP alone."""
    transports: dict[str, dict[str, int]] = {}
    if segment:
        transports['SHM'] = {'segment_size': segment, 'port_queue_capacity': pieces}
    if not _is_local():
        transports['UDPv4'] = {'receiveBufferSize': _SOCKET_BYTES}
    participant = _PARTICIPANT.format(
        descriptors=''.join(_DESCRIPTOR.format(name=name, options=''.join(
            _OPTION.format(name=option, value=value) for option, value in options.items()))
            for name, options in transports.items()),
        names=''.join(_NAME.format(name=name) for name in transports))
    return _PROFILE.format(
        participant=participant if transports else '', heartbeat=_HEARTBEAT_NANOSECONDS)


def _is_local() -> bool:
    """Tell whether rmw_fastrtps adds a UDP transport of its own; a second would send all twice."""
    return (os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE') == 'LOCALHOST'
            or os.environ.get('ROS_LOCALHOST_ONLY') == '1')


@contextmanager
def _profile(text: str) -> Iterator[None]:
    """Let Fast DDS read a profile, if it can be written anywhere, to a file that goes."""
    variable = _USER_VARIABLES[0]
    with ExitStack() as stack:
        for folder in (SHARED_MEMORY, None):
            with suppress(OSError):
                file = stack.enter_context(NamedTemporaryFile(
                    'wb', buffering=0, dir=folder, prefix='opencv_tools_', suffix='.xml'))
                file.write(text.encode())
                os.environ[variable] = file.name
                stack.callback(os.environ.pop, variable)
                break
        yield


def _keep_memory() -> None:
    """Let malloc keep what is freed; where there is no glibc, malloc has its own way."""
    mallopt = getattr(ctypes.CDLL(None), 'mallopt', None)
    if mallopt:
        mallopt(_M_MMAP_THRESHOLD, _KEPT_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
        mallopt(_M_TOP_PAD, _PADDING_BYTES)


def _in_mb(size: int) -> str:
    return f'{size / _MB:.3g} MB'
