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

"""Files and settings of pictures."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys

from drawn_robots import chain, plotted, tutorial
from opencv_tools.robot.drawing import primitives
from opencv_tools.robot.xml.document import DescriptionError
import pytest
from waiting import LONGEST_SECONDS


@pytest.mark.thorough
def test_colours_of_a_png_file(tmp_path: Path) -> None:
    from matplotlib.image import imread
    path = tmp_path / 'robot.PNG'
    plotted(tutorial(), path)
    picture = imread(path)
    assert picture.shape[0] > 800
    assert picture.shape[1] > 1200
    for color in primitives.AXIS_COLORS:
        wanted = [int(color[start:start + 2], 16) / 255 for start in (1, 3, 5)]
        assert (abs(picture[..., :3] - wanted).max(axis=2) < 0.02).sum() > 100


@pytest.mark.thorough
def test_reproducible_svg_without_a_date(tmp_path: Path) -> None:
    one, other = tmp_path / 'one.svg', tmp_path / 'other.svg'
    for path in (one, other):
        plotted(tutorial(), path)
    assert one.read_bytes() == other.read_bytes()
    assert '<dc:date>' not in one.read_text()


@pytest.mark.parametrize('name', ['robot.pdf', 'robot', 'png'])
def test_unsupported_suffix_error(tmp_path: Path, name: str) -> None:
    with pytest.raises(DescriptionError, match=r'needs the suffix \.png or \.svg, not'):
        plotted(tutorial(), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_unwritable_file_error(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match='cannot be written: No such file'):
        plotted(chain(1), tmp_path / 'nowhere' / 'robot.svg')


def test_error_without_matplotlib(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, 'matplotlib', None)
    with pytest.raises(DescriptionError, match=r"'sudo apt .*' or 'pip install matplotlib'"):
        plotted(tutorial(), tmp_path / 'robot.png')


@pytest.mark.process
def test_late_import_of_matplotlib_and_numpy() -> None:
    script = ('import sys, opencv_tools.robot.drawing.plot; '
              'assert not {"matplotlib", "numpy"} & set(sys.modules)')
    subprocess.run([sys.executable, '-c', script], check=True, timeout=LONGEST_SECONDS)


@pytest.mark.thorough
@pytest.mark.process
def test_no_remaining_figures_and_settings(tmp_path: Path) -> None:
    script = ('import matplotlib, sys; before = matplotlib.rcParams.copy(); '
              'from drawn_robots import plotted, tutorial; '
              f'plotted(tutorial(), {str(tmp_path / "robot.svg")!r}); '
              'assert "matplotlib.pyplot" not in sys.modules; '
              'assert matplotlib.rcParams.copy() == before')
    subprocess.run([sys.executable, '-c', script], check=True, timeout=LONGEST_SECONDS,
                   env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)})
