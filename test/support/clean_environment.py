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
The environment of the tests, without what the user's shell decides.

conftest imports this module before rclpy, which ends the process for an unknown middleware. A test
sets the variables that it needs, and its processes keep them.
"""

import os
import re
import time

if 'PYTEST_CURRENT_TEST' not in os.environ:  # else this is a process of a test
    for _name in tuple(os.environ):
        if re.fullmatch('(?i)ROS_(?!DISTRO|VERSION|PYTHON_VERSION).*|RMW_.*|RCUTILS_.*|'
                        'FAST(DDS|RTPS)_.*|(LANG|LC_).*|.*_proxy', _name):
            del os.environ[_name]
    os.environ.update(LANG='C.UTF-8', TZ='UTC')
    time.tzset()
    os.umask(0o022)
