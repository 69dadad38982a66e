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

"""Fast DDS set up for frames: room for whole ones in shared memory, and quick heartbeats."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
from tempfile import NamedTemporaryFile

_SHARED_MEMORY = Path('/dev/shm')
_SEGMENT_BYTES = 64 << 20
_LEAST_SEGMENT_BYTES = 16 << 20

# How often subscribers are asked what they miss. Fast DDS's own 3 s is how long a lost frame, or
# the confirmation of the last one, may take.
_HEARTBEAT_NANOSECONDS = 100_000_000

# What a user may have set; then nothing is touched.
_PROFILE_VARIABLE = 'FASTRTPS_DEFAULT_PROFILES_FILE'
_USER_VARIABLES = (
    _PROFILE_VARIABLE, 'FASTDDS_DEFAULT_PROFILES_FILE', 'FASTDDS_BUILTIN_TRANSPORTS')
_USER_FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')

_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>shared_memory</transport_id>
      <type>SHM</type>
      <segment_size>{segment}</segment_size>
      <maxMessageSize>{message}</maxMessageSize>
    </transport_descriptor>
    <transport_descriptor>
      <transport_id>udp</transport_id>
      <type>UDPv4</type>
    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="opencv_tools" is_default_profile="true">
    <rtps>
      <userTransports>
        <transport_id>shared_memory</transport_id>
        <transport_id>udp</transport_id>
      </userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
    </rtps>
  </participant>
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


@contextmanager
def transport_for_frames() -> Iterator[None]:
    """
    Give a publisher a shared-memory segment that holds several frames, and quick heartbeats.

    Fast DDS's own segment of 512 KB is smaller than one frame, so that frames are cut into pieces
    that do not fit, and are lost or late. The profile counts for a process's first node, which has
    to be made inside the block.
    Nothing is touched when the user has configured Fast DDS, uses another middleware or has set
    ``OPENCV_TOOLS_TRANSPORT=default``, nor when /dev/shm is too small.
    """
    segment = 0 if _is_configured() else _affordable_segment()
    if not segment:
        yield
        return
    with NamedTemporaryFile('w', dir=_SHARED_MEMORY, suffix='.xml') as profile:
        profile.write(_PROFILE.format(
            segment=segment, message=segment // 2, heartbeat=_HEARTBEAT_NANOSECONDS))
        profile.flush()
        os.environ[_PROFILE_VARIABLE] = profile.name
        try:
            yield
        finally:
            del os.environ[_PROFILE_VARIABLE]


def _is_configured() -> bool:
    """Tell whether the transport is not ours to choose."""
    return (
        os.environ.get('OPENCV_TOOLS_TRANSPORT') == 'default'
        or os.environ.get('RMW_IMPLEMENTATION', 'rmw_fastrtps_cpp') != 'rmw_fastrtps_cpp'
        or any(os.environ.get(variable) for variable in _USER_VARIABLES)
        or any(Path(name).exists() for name in _USER_FILES))


def _affordable_segment() -> int:
    """Give the segment's size in bytes: at most half of what is free, 0 when that is little."""
    if not os.access(_SHARED_MEMORY, os.W_OK):
        return 0
    status = os.statvfs(_SHARED_MEMORY)
    segment = min(_SEGMENT_BYTES, status.f_bavail * status.f_frsize // 2)
    return segment if segment >= _LEAST_SEGMENT_BYTES else 0
