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

"""End of a node that Fast DDS does not let end."""

from __future__ import annotations

import os
from pathlib import Path
import sys

from conftest import NodeProcess
from opencv_tools.nodes.run_node import exit_after
from opencv_tools.transport.fastdds.shared_memory import remove_dead_segments
import pytest

# PyDLL keeps the lock of the interpreter, as the function of rclpy that destroys a node.
NODE = """
import ctypes
import sys
from opencv_tools.frames import FrameNode, main
from opencv_tools.nodes import run_node

class Endless(FrameNode):
    def __init__(self):
        super().__init__('endless')
        self.done.set_result(int(sys.argv[1]))

    def close(self):
        if sys.argv[1] == '3':
            raise RuntimeError('of close')
        print('closed', flush=True)
        return super().close()

    def destroy_node(self):
        ctypes.PyDLL(None).sleep(3600)

run_node._DESTROY_SECONDS = 1
sys.exit(main(Endless, sys.argv[:1]))
"""


@pytest.mark.quick_cases(1)
@pytest.mark.process
@pytest.mark.parametrize(('result', 'status', 'output'), [
    (0, 0, 'closed\n'), (2, 2, 'closed\n'), (3, 1, '')])
def test_node_that_is_never_destroyed(
        tmp_path: Path, result: int, status: int, output: str) -> None:
    process = NodeProcess(
        [sys.executable, '-c', NODE, str(result)], tmp_path / 'node.log', dict(os.environ))
    try:
        assert process.finish() == status
        assert process.output == output
    finally:
        process.kill()
        remove_dead_segments()  # as the next publisher


def test_block_that_ends_in_time() -> None:
    def timers() -> int:
        return Path('/proc/self/timers').read_text().count('ClockID:')

    before = timers()
    with exit_after(3600, 7):
        assert timers() == before + 1
    assert timers() == before
