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

"""Installation of a missing library, for errors."""

from __future__ import annotations


def installation(library: str, apt: str = '') -> str:
    """
    Return how to install a missing library.

    Distributions refuse pip outside of virtual environments, so the sentence names the page that
    has the commands.

    :param apt: package of Ubuntu with the library; '' if Ubuntu has none.
    :returns: end of a sentence.
    """
    distribution = f"'sudo apt install {apt}' or " if apt else ''
    return f"install it with {distribution}'pip install {library}' (see Install in the README)"
