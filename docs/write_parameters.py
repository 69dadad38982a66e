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
Write ``docs/parameters.md`` and the texts of ``--help`` from the parameter tables of the nodes.

Run ``python3 docs/write_parameters.py`` after each change of a table. ``make docs`` does so too.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from opencv_tools import (
    basic_image_publisher, basic_image_subscriber, image_filter, image_viewer)
from opencv_tools.nodes.help_text import FOLDER
from opencv_tools.nodes.parameters import literal, Parameter, parameter_table

PAGE = Path(__file__).with_name('parameters.md')

_INTRODUCTION = """\
# Parameters

<!-- Written by docs/write_parameters.py from the tables in the code. Do not edit this page. -->

This page is for those who look up a parameter of a node. Set a parameter at the start with
`--ros-args -p NAME:=VALUE`, or in a file with `--params-file`. See
[Setting parameters](publisher.md#setting-parameters). `--help` prints the same as text.

- *values*: the valid values. The description explains a text without a list of values.
- *at run time*: whether the parameter can be changed while the node runs, for example with
  `ros2 param set`.

The settings of a camera, such as `brightness`, are further parameters of `img_publisher`. They
depend on the camera. `ros2 param list` shows them.
"""

_HEADING = """
## {executable}

Parameters of the node `{node}`:

| parameter | type | default | values | at run time | description |
|---|---|---|---|---|---|
"""

# Values that are too many for a cell.
_LISTS = {('img_publisher', 'encoding'): '[encodings](publisher.md#encodings)'}


def parameters_page() -> str:
    """Return the text of the page."""
    return ''.join((
        _INTRODUCTION,
        _section('img_publisher', 'image_publisher', basic_image_publisher.PARAMETERS),
        _section('img_subscriber', 'image_subscriber', basic_image_subscriber.PARAMETERS),
        _section('img_filter', 'image_filter', image_filter.PARAMETERS),
        _section('img_viewer', 'image_viewer', image_viewer.PARAMETERS)))


def help_texts() -> dict[Path, str]:
    """Return the text of ``--help`` of each node, by its file; ROS is not needed to read it."""
    executables = [module.EXECUTABLE for module in (
        basic_image_publisher, basic_image_subscriber, image_filter, image_viewer)]
    return {FOLDER / f'{one.name}.txt': one.help_text(parameter_table(one.settings)) + '\n'
            for one in executables if one.settings}


def _section(executable: str, node: str, table: Sequence[Parameter]) -> str:
    return _HEADING.format(executable=executable, node=node) + ''.join(
        f'| {" | ".join(_row(executable, parameter))} |\n' for parameter in table)


def _row(executable: str, parameter: Parameter) -> tuple[str, ...]:
    cells = (
        f'`{parameter.name}`', parameter.type_name, _code(literal(parameter.default)),
        _LISTS.get((executable, parameter.name)) or parameter.values(_code),
        'yes' if parameter.changeable else 'no', parameter.description)
    return tuple(cell.replace('|', r'\|') for cell in cells)


def _code(text: str) -> str:
    return f'`{text}`'


if __name__ == '__main__':
    PAGE.write_text(parameters_page(), encoding='utf-8')
    FOLDER.mkdir(exist_ok=True)
    for path, text in help_texts().items():
        path.write_text(text, encoding='utf-8')
