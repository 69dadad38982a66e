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

"""A link between two hosts with a delay and losses, as of netem, which not every kernel has."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import ctypes
import fcntl
import heapq
import os
from pathlib import Path
import random
import select
import struct
import subprocess
import sys
import time

from hosts import Host, INTERFACE, new_host

# Constants of <linux/if_tun.h> and <sched.h>.
_TUNSETIFF, _TAP_WITHOUT_HEADER, _NEWNET = 0x400454ca, 0x1002, 0x40000000
_MAX_PACKET = 1 << 16


@contextmanager
def late_hosts(delay_ms: int, loss: int) -> Iterator[tuple[Host, Host]]:
    """
    Create two hosts whose packets arrive late or are lost.

    :param delay_ms: delay of each packet in ms.
    :param loss: lost packets in per cent.
    """
    with (new_host('10.78.0.1') as near, new_host('10.78.0.2') as far, subprocess.Popen(
            [sys.executable, __file__, str(near.pid), str(far.pid), str(delay_ms), str(loss)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE) as link):
        assert link.stdin and link.stdout
        link.stdout.readline()
        for host in (near, far):
            host.run('ip', 'address', 'add', f'{host.address}/24', 'dev', INTERFACE)
            host.connect()
        try:
            yield near, far
        finally:
            link.stdin.close()


def open_tap(pid: str) -> int:
    """Create a network interface in the namespace of a process, and return its file."""
    with Path(f'/proc/{pid}/ns/net').open() as namespace:
        if ctypes.CDLL(None, use_errno=True).setns(namespace.fileno(), _NEWNET):
            raise OSError(ctypes.get_errno(), 'setns')
    tap = os.open('/dev/net/tun', os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(tap, _TUNSETIFF, struct.pack(
        '16sH22x', INTERFACE.encode(), _TAP_WITHOUT_HEADER))
    return tap


def pass_on(near: str, far: str, delay_ms: str, loss: str) -> None:
    """Pass packets on between two namespaces, until the standard input ends."""
    taps = open_tap(near), open_tap(far)
    print('ready', flush=True)
    waiting: list[tuple[float, int, int, bytes]] = []
    number, delay, part = 0, float(delay_ms) / 1000, float(loss) / 100
    while True:
        wait = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
        readable = select.select([0, *taps], [], [], wait)[0]
        if 0 in readable:
            return
        now = time.monotonic()
        for index, tap in enumerate(taps):
            if tap in readable:
                packet = os.read(tap, _MAX_PACKET)
                number += 1
                if random.random() >= part:
                    heapq.heappush(waiting, (now + delay, number, taps[1 - index], packet))
        while waiting and waiting[0][0] <= now:
            _, _, tap, packet = heapq.heappop(waiting)
            with suppress(OSError):  # the interface is not up yet
                os.write(tap, packet)


if __name__ == '__main__':
    pass_on(*sys.argv[1:])
