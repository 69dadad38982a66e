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

"""Fields of settings that are parameters of a node; a node reads them as a table."""

from __future__ import annotations

from dataclasses import field
from typing import Any

#: Lowest rate in Hz, so that nothing waits for longer than 10 s.
LOWEST_RATE = 0.1


def parameter(default: str | int | float, description: str, **options: Any) -> Any:
    """
    Return the field of a settings class for a parameter of the same name.

    :param default: default value; its type is the type of the parameter.
    :param description: noun phrase that stands alone, see ``opencv_tools.nodes.parameters``.
    :param options: further fields of ``Parameter`` in ``opencv_tools.nodes.parameters``.
    """
    return field(default=default, metadata={**options, 'description': description})


def rate_parameter(
    default: float, description: str, highest: float, *, or_zero: bool = True, **options: Any,
) -> Any:
    """
    Return the field of a settings class for a rate in Hz, at least ``LOWEST_RATE``.

    :param description: description, as for `parameter`.
    :param or_zero: whether the rate may be 0, with the meaning in the description.
    :param options: further fields of ``Parameter`` in ``opencv_tools.nodes.parameters``.
    """
    return parameter(
        default, description, bounds=(LOWEST_RATE, highest), or_zero=or_zero, **options)


def parameter_group(settings: Any, prefix: str = '') -> Any:
    """
    Return the field of a settings class for the settings of a part, whose fields are parameters.

    :param settings: the part's settings with the default values.
    :param prefix: begin of the names of the parameters before those of the fields.
    """
    return field(default=settings, metadata={'prefix': prefix})
