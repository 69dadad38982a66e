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

"""Configuration of Fast DDS and malloc for large frames, unless the user configured them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, ExitStack, suppress
import ctypes
from dataclasses import dataclass
import fcntl
from functools import cache
import math
import os
from pathlib import Path
from tempfile import NamedTemporaryFile

from opencv_tools.transport.fastdds.shared_memory import (
    find_other_user, free_bytes, is_writable, remove_dead_profiles, remove_dead_segments,
    SHARED_MEMORY)
from opencv_tools.transport.scheduling import explain_refusal
from rclpy.utilities import get_rmw_implementation_identifier

#: Text of ``--help`` about the environment.
ENVIRONMENT_HELP = (
    'environment:\n'
    '  OPENCV_TOOLS_TRANSPORT=default  do not configure Fast DDS and malloc, to compare, or\n'
    '                                  because your own profile is not set by a variable of\n'
    '                                  Fast DDS; large frames may be lost')

_MB = 1 << 20
# Number of frames for which the segment has room, and the number below which frames are lost.
_FRAMES = 8
_MIN_FRAMES = 3
_MIN_SEGMENT = 16 * _MB
_MAX_SEGMENT = 256 * _MB
_DEFAULT_SEGMENT = _MB // 2  # default of Fast DDS, for small messages

# The port of a reader lists waiting fragments and drops further ones. The default of Fast DDS, 512
# fragments, holds 1.35 frames of 3840x2160. A fragment has 65482 bytes, the limit of UDP, or less.
_FRAGMENT_BYTES = 65_000
_MIN_FRAGMENTS = 512
_MAX_FRAGMENTS = 8192
_DEFAULT_FRAGMENTS = 4096  # more than eight frames of 3840x2160, for frames of unknown size
_DESCRIPTOR_BYTES = 20  # bytes of a port for each fragment
_PORT_SHARE = 1 / 16  # share of the free memory for a port; a participant has two or three

# Requested receive buffer of UDP sockets; the kernel limits it to net.core.rmem_max. A send buffer
# of this size would overload a slow link with repeated data.
_SOCKET_BYTES = 4 * _MB

# Period in which a writer asks readers for missing messages. A lost frame, or the confirmation of
# the last frame, may take one period. The default of Fast DDS is 3 s.
_HEARTBEAT_NANOSECONDS = 100_000_000

# Parameters of mallopt(3). They keep glibc from returning the memory of each frame to the kernel,
# which would have to map it again page by page.
_M_TRIM_THRESHOLD = -1
_M_TOP_PAD = -2
_M_MMAP_THRESHOLD = -3
_KEPT_BYTES = 256 * _MB
_PADDING_BYTES = 64 * _MB

# Variables of the profile, of Fast DDS 2 and Fast DDS 3.
_OLD_VARIABLE, _VARIABLE = 'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'
# Variables and files of the user's own configuration, which is not changed.
_USER_VARIABLES = (_OLD_VARIABLE, _VARIABLE, 'FASTDDS_BUILTIN_TRANSPORTS')
_USER_FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')

_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">{participant}
  <data_writer profile_name="opencv_tools_writer" is_default_profile="true">
    <times><{period}><sec>0</sec><nanosec>{heartbeat}</nanosec></{period}></times>
  </data_writer>
</profiles>
"""
_PARTICIPANT = """
  <transport_descriptors>{descriptors}
  </transport_descriptors>
  <participant profile_name="opencv_tools" is_default_profile="true">
    <rtps>
      <userTransports>{names}</userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
    </rtps>
  </participant>"""
_DESCRIPTOR = """
    <transport_descriptor>{}{}</transport_descriptor>"""
_THREADS = '<default_reception_threads>{}</default_reception_threads>'

# rmw_fastrtps adds a shared memory transport of its own, for which Fast DDS logs errors.
_NO_SHARED_MEMORY = (
    f'{SHARED_MEMORY} is not writable: frames are sent over UDP and may be late; errors of '
    'RTPS_TRANSPORT_SHM below have the same cause')

_OTHER_USER = ('user {user} also runs nodes on this machine, and Fast DDS shares no memory '
               'between users: {what}; run all nodes as one user')
_UDP_EFFECT = 'frames are sent over UDP and may be late'
_LOCALHOST_EFFECT = 'with discovery range LOCALHOST those nodes and this one exchange no frames'


@dataclass(frozen=True)
class FastDdsSetup:
    """
    Result of the configuration of Fast DDS, for frames to subscribers on this machine.

    :param summary: summary of the configuration and its reason, as a sentence.
    :param segment: bytes of shared memory for frames; 0 if frames are sent over UDP. None if the
        user configured Fast DDS, or another size would not help.
    :param free_bytes: free bytes of shared memory before the configuration.
    :param warning: problem that does not depend on the size of the frames; '' if there is none.
    """

    summary: str
    segment: int | None = None
    free_bytes: int = 0
    warning: str = ''

    def size_warning(self, frame_bytes: int) -> str:
        """
        Return a warning if frames of a size will be late or lost.

        :param frame_bytes: bytes of a frame.
        :returns: the reason and a remedy as a sentence, '' if the frames fit.
        """
        if self.segment is None or self.segment >= _MIN_FRAMES * frame_bytes:
            return ''
        target = 2 * _target_segment(frame_bytes)
        if self.free_bytes >= target:
            return (f'the shared memory of {_in_mb(self.segment)} reserved at startup is too '
                    f'small for frames of {_in_mb(frame_bytes)}, which may be late or lost: start '
                    'the node with the frame size that it publishes')
        return (f'{SHARED_MEMORY} had {_in_mb(self.free_bytes)} free, too little for frames of '
                f'{_in_mb(frame_bytes)}, which may be late or lost: increase it to '
                f'{_in_mb(target)}, in Docker with --shm-size={math.ceil(target / _MB)}m or '
                '--ipc=host')


NOT_CONFIGURED = FastDdsSetup('Fast DDS is not configured')


@contextmanager
def configured_fastdds(frame_bytes: int, priority: int = 0) -> Iterator[FastDdsSetup]:
    """
    Configure Fast DDS for several frames in shared memory and a short heartbeat, and malloc.

    The default segment of Fast DDS, 512 KB, is smaller than one frame. Its fragments do not fit,
    and frames are lost or late. The default sockets are too small as well. The profile applies to
    the first node of the process, which has to be created inside the block. Nothing is configured
    if the user has configured Fast DDS, uses another middleware or has set
    ``OPENCV_TOOLS_TRANSPORT=default``.

    :param frame_bytes: expected bytes of a published frame; 0 if no frames are published.
    :param priority: real-time priority of the threads of Fast DDS that receive, from 1 to 99; 0,
        or without the permission, for normal scheduling.
    :returns: the result of the configuration.
    """
    reason = _user_configuration()
    if reason:
        yield FastDdsSetup(f'Fast DDS and malloc are not configured: {reason}')
        return
    _keep_memory()
    remove_dead_profiles()
    removed = remove_dead_segments()
    available = free_bytes()
    priority = 0 if explain_refusal(priority) else priority  # Fast DDS would log errors
    other_user = find_other_user()
    if other_user and not is_local():  # if local, rmw_fastrtps adds its own shared memory
        with _profile(_describe_profile(0, 0, priority)):
            yield FastDdsSetup('UDP for frames, because of the other user', free_bytes=available,
                               warning=_OTHER_USER.format(user=other_user, what=_UDP_EFFECT))
        return
    segment = _segment_bytes(frame_bytes, available)
    with _profile(_describe_profile(
            segment, _port_capacity(frame_bytes, available), priority)):
        yield FastDdsSetup(
            f'{_in_mb(segment)} of shared memory beside UDP for frames of {_in_mb(frame_bytes)}; '
            f'{SHARED_MEMORY} has {_in_mb(available)} free; {removed} dead segments removed; '
            'malloc keeps the memory of frames', segment, available,
            _NO_SHARED_MEMORY if not is_writable() else
            _OTHER_USER.format(user=other_user, what=_LOCALHOST_EFFECT) if other_user else '')


def _user_configuration() -> str:
    """Return why Fast DDS must not be configured, '' if it may be."""
    if os.environ.get('OPENCV_TOOLS_TRANSPORT') == 'default':
        return 'OPENCV_TOOLS_TRANSPORT is default'
    middleware = os.environ.get('RMW_IMPLEMENTATION', 'rmw_fastrtps_cpp')
    if middleware != 'rmw_fastrtps_cpp':
        return f'RMW_IMPLEMENTATION is {middleware}'
    for variable in _USER_VARIABLES:
        if os.environ.get(variable):
            return f'{variable} is set'
    return next((f'{name} exists' for name in _USER_FILES
                 if os.access(name, os.F_OK)), '')  # unlike Path.exists() this never raises


def _target_segment(frame_bytes: int) -> int:
    if not frame_bytes:
        return _DEFAULT_SEGMENT
    return max(min(max(_FRAMES * frame_bytes, _MIN_SEGMENT), _MAX_SEGMENT),
               _MIN_FRAMES * frame_bytes)


def _segment_bytes(frame_bytes: int, available: int) -> int:
    """Return the size of the segment: at most half of the free memory, 0 if that is too little."""
    segment = min(_target_segment(frame_bytes), available // 2)
    return segment if segment >= max(_MIN_FRAMES * frame_bytes, _DEFAULT_SEGMENT) else 0


def _port_capacity(frame_bytes: int, available: int) -> int:
    """Return the number of fragments that may wait in a port: those of all frames of a segment."""
    target = (math.ceil(_FRAMES * frame_bytes / _FRAGMENT_BYTES) if frame_bytes
              else _DEFAULT_FRAGMENTS)
    affordable = int(available * _PORT_SHARE) // _DESCRIPTOR_BYTES
    return max(_MIN_FRAGMENTS, min(target, affordable, _MAX_FRAGMENTS))


def _describe_profile(segment: int, fragments: int, priority: int) -> str:
    """Return the XML profile; a segment of 0 bytes selects UDP alone, faster than a small one."""
    transports: dict[str, dict[str, int]] = {}
    if segment:
        transports['SHM'] = {'segment_size': segment, 'port_queue_capacity': fragments}
    if not is_local():
        transports['UDPv4'] = {'receiveBufferSize': _SOCKET_BYTES}
    threads = _THREADS.format(_elements(
        scheduling_policy=os.SCHED_RR, priority=priority)) if priority else ''
    participant = _PARTICIPANT.format(
        descriptors=''.join(
            _DESCRIPTOR.format(_elements(transport_id=name, type=name, **options), threads)
            for name, options in transports.items()),
        names=''.join(_elements(transport_id=name) for name in transports))
    return _PROFILE.format(
        participant=participant if transports else '', heartbeat=_HEARTBEAT_NANOSECONDS,
        period='heartbeatPeriod' if is_fastdds_2() else 'heartbeat_period')


def _elements(**values: object) -> str:
    return ''.join(f'<{tag}>{value}</{tag}>' for tag, value in values.items())


def is_local() -> bool:
    """
    Return whether nodes of this machine only are discovered, without static peers.

    rmw_fastrtps then adds its own UDP transport; a second one would send twice.
    """
    return (os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE') == 'LOCALHOST'
            or os.environ.get('ROS_LOCALHOST_ONLY') == '1')


@contextmanager
def _profile(text: str) -> Iterator[None]:
    """Write a profile to a temporary file, if possible, and set the variable of Fast DDS."""
    variable = _OLD_VARIABLE if is_fastdds_2() else _VARIABLE
    with ExitStack() as stack:
        for folder in (SHARED_MEMORY, None):
            with suppress(OSError):
                file = stack.enter_context(NamedTemporaryFile(
                    'wb', buffering=0, dir=folder, prefix='opencv_tools_', suffix='.xml',
                    delete=False))
                # Another node removes a file that is not locked: it is unlinked before the close.
                stack.callback(Path(file.name).unlink, missing_ok=True)
                fcntl.flock(file, fcntl.LOCK_EX)
                file.write(text.encode())
                os.environ[variable] = file.name
                stack.callback(os.environ.pop, variable)
                break
        yield


@cache
def is_fastdds_2() -> bool:
    """Return whether the middleware of this process has Fast DDS 2, as that of Jazzy."""
    get_rmw_implementation_identifier()  # which loads it
    return 'libfastrtps.so' in Path('/proc/self/maps').read_text()


def _keep_memory() -> None:
    """Configure glibc's malloc to keep freed memory; do nothing with another malloc."""
    mallopt = getattr(ctypes.CDLL(None), 'mallopt', None)
    if mallopt:
        mallopt(_M_MMAP_THRESHOLD, _KEPT_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
        mallopt(_M_TOP_PAD, _PADDING_BYTES)


def _in_mb(size: int) -> str:
    return f'{size / _MB:.3g} MB'
