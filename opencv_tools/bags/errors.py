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

"""The error of bags, and the check of the library that they need."""

from __future__ import annotations

from opencv_tools.base.remedies import installation
from opencv_tools.image.errors import ImageError


class BagError(ImageError):
    """A bag cannot be read or written. The message contains the reason."""


def check_mcap() -> None:
    """
    Check that the library mcap is installed.

    :raises BagError: the library cannot be imported; the message includes the remedy.
    """
    try:
        import mcap.records  # noqa: F401
    except ImportError as err:
        raise BagError(f'bags need the library mcap, which cannot be imported ({err}); '
                       f'{installation("mcap")}') from err
