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

"""A writable folder for the log of ROS; rcl does not start without one."""

from __future__ import annotations

from contextlib import suppress
import os
from pathlib import Path
from tempfile import mkdtemp

_VARIABLE = 'ROS_LOG_DIR'


def replace_log_folder() -> str:
    """
    Set a temporary log folder if the default one is not writable.

    :returns: a sentence about the temporary folder, '' if the default one is used.
    """
    folder = _log_folder()
    if folder and _is_writable(folder):
        return ''
    reason = (f'{folder} cannot be written' if folder
              else 'there is no home directory, HOME is unset')
    try:
        temporary = mkdtemp(prefix='opencv_tools_log_')
    except OSError:
        return ''  # rcl reports the error
    os.environ[_VARIABLE] = temporary
    return f'{reason}: ROS logs are written to {temporary}; set {_VARIABLE} to use another folder'


def _log_folder() -> Path | None:
    """Return the folder that rcl uses, from ROS_LOG_DIR, ROS_HOME or HOME."""
    for variable, below in ((_VARIABLE, ''), ('ROS_HOME', 'log'), ('HOME', '.ros/log')):
        if os.environ.get(variable):
            return Path(os.environ[variable], below)
    return None


def _is_writable(folder: Path) -> bool:
    """Return whether a folder is writable, after it is created if needed."""
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return folder.is_absolute() and os.access(folder, os.W_OK | os.X_OK)
