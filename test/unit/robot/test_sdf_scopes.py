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

"""Selection of a model of an SDF world."""

from __future__ import annotations

from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
import pytest
from sdf_models import read_text


def test_selected_model_of_a_world() -> None:
    text = ('<sdf version="1.9"><world name="w"><light name="l"/><light name="k"/><gravity/>'
            '<model name="m"><link name="a"/></model><model name="n"><link name="b"/></model>'
            '</world></sdf>')
    report = Report()
    assert read_text(text, report, 'n').links[0].name == 'b'
    assert [note.element for note in report.warnings] == ['light', 'gravity', 'model']
    assert "'l', 'k'" in report.warnings[0].message
    with pytest.raises(DescriptionError, match="has no model 'x'; select one of m, n"):
        read_text(text, model='x')
