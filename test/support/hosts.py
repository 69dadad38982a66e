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

"""Network namespaces as hosts, each with its own /dev/shm, and a link between them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import json
from pathlib import Path
import subprocess

from waiting import communicate, LONGEST_SECONDS

INTERFACE = 'eth0'

# A host lasts as long as a process in it. This one ends with its input: with us at the latest.
_KEEPER = """
mount -t tmpfs -o size="$1" tmpfs /dev/shm && ip link set lo up && echo ready && exec cat
"""

# What netem would do, which not every kernel has. A part of a thousand is lost as it comes in, of
# datagrams or of the packets that a large one travels in.
_LOSSES = {
    'datagrams': 'table inet faults {{ counter lost {{ }}; chain in {{ type filter hook input '
                 'priority 0; iifname {interface} numgen random mod 1000 < {lost} '
                 'counter name lost drop; }}; }}',
    'packets': 'table inet faults {{ counter lost {{ }}; chain in {{ type filter hook ingress '
               'device {interface} priority 0; numgen random mod 1000 < {lost} '
               'counter name lost drop; }}; }}',
}


class Host:
    """What runs in it sees a machine of its own, but for the files and the processes."""

    def __init__(self, address: str = '127.0.0.1', shared_memory: str = '256m') -> None:
        """
        Begin with no network but ``lo``.

        :param address: what the host will have on a cable.
        :param shared_memory: the size of /dev/shm, as ``mount`` reads it.
        """
        self.address = address
        self._keeper = subprocess.Popen(
            ['unshare', '--net', '--mount', '--propagation', 'private',
             'sh', '-c', _KEEPER, 'sh', shared_memory],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._keeper.stdout is not None
        assert self._keeper.stdout.readline() == b'ready\n', 'the host did not start'

    @property
    def pid(self) -> int:
        return self._keeper.pid

    @property
    def within(self) -> tuple[str, ...]:
        """Return the prefix of a command that runs on the host."""
        return 'nsenter', '--target', str(self.pid), '--net', '--mount'

    @property
    def shared_memory(self) -> Path:
        """Return the path of the host's /dev/shm on this machine."""
        return Path(f'/proc/{self.pid}/root/dev/shm')

    def run(self, *command: str, text: str = '') -> str:
        """Run a command there, with a text as its input; what it prints."""
        return subprocess.run(
            [*self.within, *command], input=text, check=True, text=True, stdout=subprocess.PIPE,
            timeout=LONGEST_SECONDS).stdout

    def apply_rules(self, rules: str) -> None:
        """Drop packets as rules of nftables say."""
        self.run('nft', '-f', '-', text=rules)

    def lose(self, unit: str, per_thousand: int = 1) -> None:
        """Drop a random part of what comes out of the cable: ``datagrams`` or ``packets``."""
        self.apply_rules(_LOSSES[unit].format(interface=INTERFACE, lost=per_thousand))

    def connect(self) -> None:
        """Connect the link, the only route of the host."""
        self.run('ip', 'link', 'set', INTERFACE, 'up')
        self.run('ip', 'route', 'replace', 'default', 'dev', INTERFACE)

    def disconnect(self) -> None:
        """Disconnect the link."""
        self.run('ip', 'link', 'set', INTERFACE, 'down')

    def sent_bytes(self) -> int:
        """Count what went into the cable."""
        shown, = json.loads(self.run(
            'ip', '-json', '-statistics', 'link', 'show', 'dev', INTERFACE))
        return int(shown['stats64']['tx']['bytes'])

    def lost(self) -> int:
        """Count what came out of the cable and was dropped by ``lose``."""
        listed = json.loads(self.run('nft', '--json', 'list', 'counter', 'inet', 'faults', 'lost'))
        return sum(entry['counter']['packets'] for entry in listed['nftables']
                   if 'counter' in entry)

    def close(self) -> None:
        """Release the host; it ends with its last process."""
        communicate(self._keeper)


@contextmanager
def new_host(address: str = '127.0.0.1', shared_memory: str = '256m') -> Iterator[Host]:
    """Create a host for the duration of the block."""
    host = Host(address, shared_memory)
    try:
        yield host
    finally:
        host.close()


@contextmanager
def linked_hosts(rate: str, burst: str, latency: str) -> Iterator[tuple[Host, Host]]:
    """
    Create two hosts with a link between them.

    :param rate: rate of the link, as ``tc`` reads it.
    :param burst: size of its bucket.
    :param latency: longest time of a packet in its queue.
    """
    with new_host('10.77.0.1') as near, new_host('10.77.0.2') as far:
        near.run('ip', 'link', 'add', INTERFACE, 'type', 'veth',
                 'peer', 'name', INTERFACE, 'netns', str(far.pid))
        for host in (near, far):
            # Chromium cancels its requests when an address appears, as IPv6's does after seconds.
            host.run('ip', 'link', 'set', INTERFACE, 'addrgenmode', 'none')
            host.run('ip', 'address', 'add', f'{host.address}/24', 'dev', INTERFACE)
            host.connect()
            host.run('tc', 'qdisc', 'add', 'dev', INTERFACE, 'root',
                     'tbf', 'rate', rate, 'burst', burst, 'latency', latency)
        yield near, far


@contextmanager
def two_hosts(loss: str, per_thousand: int = 1) -> Iterator[tuple[Host, Host]]:
    """
    Create two hosts with a link of 100 Mbit/s that loses a part.

    :param loss: lost units, ``datagrams`` or ``packets``.
    :param per_thousand: number of lost units in a thousand.
    """
    with linked_hosts('100mbit', '128kb', '100ms') as hosts:
        for host in hosts:
            host.lose(loss, per_thousand)
        yield hosts
