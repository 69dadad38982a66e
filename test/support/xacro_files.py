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

"""Small xacro files, and functions to expand them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from opencv_tools.robot.xacro.expand import expand
from opencv_tools.robot.xml.document import Element, parse
from opencv_tools.robot.xml.report import Report

HEAD = '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro">'
MESH = '<link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual></link>'
ENDLESS = '<xacro:macro name="m"><xacro:m/></xacro:macro>\n<xacro:m/>'


def expanded(path: Path, content: str, arguments: Mapping[str, str] | None = None,
             report: Report | None = None) -> Element:
    path.write_text(HEAD + content + '</robot>')
    report = report or Report()
    data = expand(str(path), path.read_bytes(), arguments or {}, report)
    return parse(data, str(path), report)


def attribute(root: Element, name: str) -> str:
    return str(root.xpath(f'string(.//*/@{name})'))


def link_name(root: Element) -> str:
    return str(root.xpath('string(link/@name)'))
