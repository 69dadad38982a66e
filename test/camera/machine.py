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
Run the tests of the camera in a machine that has one: python machine.py [arguments for pytest].

The camera is `vivid`, a V4L2 driver of Linux that needs no hardware, and the machine is QEMU in
software. It has a kernel of its own; all other files it has from its host, in their usual places.
"""

from __future__ import annotations

import os
from pathlib import Path
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time

from kernel import get_kernel, Kernel, MachineError

PROJECT = Path(__file__).resolve().parents[2]
CACHE = PROJECT / '.camera'
TIMEOUT = 1800.0  # seconds from the start of the machine to its end, on the busiest host

TOOLS = ('qemu-system-x86_64', 'modprobe', 'depmod', 'busybox', 'v4l2-ctl')
REMEDY = 'sudo apt install qemu-system-x86 kmod busybox-static v4l-utils'

# What the machine cannot have from its host because it is needed to get there.
DRIVERS = ('virtio_pci', '9pnet_virtio', '9p', 'overlay')
USERS = {
    'passwd': 'root:x:0:0:root:/root:/bin/sh\nnobody:x:65534:65534:nobody:/:/bin/false\n',
    'group': 'root:x:0:\nvideo:x:44:\nnogroup:x:65534:\n',
    'hosts': '127.0.0.1 localhost\n',
}


def check_host() -> None:
    """Name what is missing here, and how to get it."""
    if sys.prefix == sys.base_prefix:
        raise MachineError('the machine runs what .venv holds: make test-camera')
    missing = [name for name in TOOLS if shutil.which(name) is None]
    if missing:
        verb = 'is' if len(missing) == 1 else 'are'
        raise MachineError(f'{", ".join(missing)} {verb} missing: {REMEDY}')
    # The name of the dynamic loader stands among the first bytes of what wants one.
    if b'/ld-linux' in busybox().read_bytes()[:1024]:
        raise MachineError(f'{busybox()} is not the static one: {REMEDY}')


def busybox() -> Path:
    return Path(shutil.which('busybox') or 'busybox')


def trees() -> list[Path]:
    """List the folders that the machine shares with its host, none within another."""
    wanted = {Path('/usr'), Path(sys.base_prefix), Path(sys.prefix), PROJECT}
    return sorted(path for path in wanted if wanted.isdisjoint(path.parents))


def settings(kernel: Kernel) -> dict[str, str]:
    """Return the environment of the tests."""
    return {
        'PATH': f'{sys.prefix}/bin:/usr/local/bin:/usr/bin:/usr/sbin',
        'HOME': '/root',
        'LANG': 'C.UTF-8',
        'TERM': os.environ.get('TERM', 'dumb') if sys.stdout.isatty() else 'dumb',
        'VIRTUAL_ENV': sys.prefix,
        'AMENT_PREFIX_PATH': sys.prefix,
        'ROS_DISTRO': 'jazzy',
        'ROS_VERSION': '2',
        'ROS_PYTHON_VERSION': '3',
        'ROS_LOG_DIR': '/tmp/ros',
        'OPENCV_TOOLS_CAMERA_MACHINE': '1',
        'PYTEST_DISABLE_PLUGIN_AUTOLOAD': '1',  # saves seconds, and the tests want none
        # for init
        'PROJECT': str(PROJECT),
        'MODULES': str(kernel.modules),
    }


def make_initrd(folder: Path, kernel: Kernel, arguments: list[str]) -> Path:
    """Pack what the machine needs until it has the files of its host."""
    root = folder / 'root'
    for name in ('dev', 'etc', 'modules', 'proc', 'sys', 'tmp'):
        (root / name).mkdir(parents=True)
    for name in ('bin', 'lib', 'lib64', 'sbin'):
        (root / name).symlink_to(f'usr/{name}')
    for name, text in USERS.items():
        (root / 'etc' / name).write_text(text)
    shutil.copy(busybox(), root / 'busybox')
    shutil.copy(Path(__file__).with_name('init'), root)
    for number, module in enumerate(kernel.files_of(*DRIVERS)):
        shutil.copy(module, root / 'modules' / f'{number:02}-{module.name}')
    tests = [sys.executable, '-m', 'pytest', '-p', 'no:cacheprovider', '-s', '-q', 'test/camera',
             *arguments]
    (root / 'tests').write_text(f'{shlex.join(tests)}\n')
    (root / 'trees').write_text(''.join(f'{path}\n' for path in trees()))
    (root / 'settings').write_text(''.join(
        f'export {name}={shlex.quote(value)}\n' for name, value in settings(kernel).items()))

    initrd = folder / 'initrd'
    names = sorted(str(path.relative_to(root)) for path in root.rglob('*'))
    with initrd.open('wb') as packed:
        subprocess.run([busybox(), 'cpio', '-o', '-H', 'newc', '-R', '0:0'], cwd=root,
                       input='\n'.join(names).encode(), stdout=packed, stderr=subprocess.PIPE,
                       check=True)
    return initrd


def qemu(kernel: Kernel, initrd: Path, results: Path) -> list[str]:
    """Return the command that runs the virtual machine until it powers off."""
    command = [
        'qemu-system-x86_64', '-machine', 'pc', '-m', '1536M',
        # In software always: a /dev/kvm that opens may hang all the same. OpenCV wants more than
        # the default processor can do; two processors are slower than one on a busy host. With
        # AVX2, numpy.argsort ends with a segmentation fault in QEMU 7.2.
        '-accel', 'tcg', '-cpu', 'max,-avx2', '-smp', '1',
        '-nodefaults', '-display', 'none', '-monitor', 'none', '-serial', 'stdio', '-no-reboot',
        '-kernel', str(kernel.image), '-initrd', str(initrd),
        '-append', 'console=ttyS0 quiet loglevel=1 panic=-1',
        '-virtfs', f'local,mount_tag=results,security_model=none,path={_value(results)}',
    ]
    for number, path in enumerate(trees()):
        command += ['-virtfs', f'local,mount_tag=tree{number},security_model=none,readonly=on,'
                    f'multidevs=remap,path={_value(path)}']
    return command


def _value(path: Path) -> str:
    return str(path).replace(',', ',,')  # as QEMU wants it among its options


def run(arguments: list[str]) -> int:
    """Run pytest in a new machine; its exit status."""
    check_host()
    kernel = get_kernel(CACHE)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        results = folder / 'results'
        results.mkdir()
        command = qemu(kernel, make_initrd(folder, kernel, arguments), results)
        started = time.time()
        machine = subprocess.Popen(command, stdin=subprocess.DEVNULL)
        try:
            machine.wait(TIMEOUT)
        except subprocess.TimeoutExpired:
            raise MachineError(f'the test machine did not end within {TIMEOUT:.0f} s') from None
        finally:
            machine.kill()
            machine.wait()
        ended = time.time()
        try:
            status = int((results / 'status').read_text())
            booted = (results / 'booted').stat().st_mtime
        except (FileNotFoundError, ValueError):
            raise MachineError('the test machine ended without a result') from None
    print(f'The test machine booted in {booted - started:.0f} s and ran for '
          f'{ended - started:.0f} s')
    return status


def main() -> int:
    for number in (signal.SIGINT, signal.SIGTERM):  # unwind, and so take the machine along
        signal.signal(number, lambda received, _: sys.exit(128 + received))
    os.environ['PATH'] += ':/usr/sbin:/sbin'  # where Debian keeps modprobe, for root alone
    try:
        return run(sys.argv[1:])
    except MachineError as err:
        print(err, file=sys.stderr)
        return 1


if __name__ == '__main__':
    sys.exit(main())
