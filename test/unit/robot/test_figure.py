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

from pathlib import Path
import subprocess
import sys

from opencv_tools.robot.drawing import primitives
from opencv_tools.robot.drawing.conventions import plot_conventions
from opencv_tools.robot.frames.listing import frames
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.xml.document import DescriptionError
from opencv_tools.robot.xml.report import Report
import pytest
from waiting import LONGEST_SECONDS

ARM = Path(__file__).parents[3] / 'urdf' / 'my_arm.urdf'


def plotted(path: Path) -> None:
    """Write the picture of a robot to a file."""
    robot = read_robot(str(ARM), Report())[0]
    plot_conventions(robot, frames(robot, {}), str(path))


@pytest.mark.thorough
def test_colours_of_a_png_file(tmp_path: Path) -> None:
    from matplotlib.image import imread
    path = tmp_path / 'robot.PNG'
    plotted(path)
    picture = imread(path)
    assert picture.shape[0] > 400
    assert picture.shape[1] > 900
    for color in primitives.AXIS_COLORS:
        wanted = [int(color[start:start + 2], 16) / 255 for start in (1, 3, 5)]
        assert (abs(picture[..., :3] - wanted).max(axis=2) < 0.02).sum() > 100


@pytest.mark.thorough
def test_reproducible_svg_without_a_date(tmp_path: Path) -> None:
    one, other = tmp_path / 'one.svg', tmp_path / 'other.svg'
    for path in (one, other):
        plotted(path)
    assert one.read_bytes() == other.read_bytes()
    assert '<dc:date>' not in one.read_text()


@pytest.mark.parametrize('name', ['robot.pdf', 'robot', 'png'])
def test_unsupported_suffix_error(tmp_path: Path, name: str) -> None:
    with pytest.raises(DescriptionError, match=r'needs the suffix \.png or \.svg, not'):
        plotted(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_unwritable_file_error(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match='cannot be written: No such file'):
        plotted(tmp_path / 'nowhere' / 'robot.svg')


def test_error_without_matplotlib(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, 'matplotlib', None)
    with pytest.raises(DescriptionError, match=r"'pip install matplotlib'"):
        plotted(tmp_path / 'robot.png')


@pytest.mark.process
def test_late_import_of_matplotlib_and_numpy() -> None:
    script = ('import sys, opencv_tools.robot.drawing.conventions; '
              'assert not {"matplotlib", "numpy"} & set(sys.modules)')
    subprocess.run([sys.executable, '-c', script], check=True, timeout=LONGEST_SECONDS)


@pytest.mark.thorough
@pytest.mark.process
def test_no_remaining_figures_and_settings(tmp_path: Path) -> None:
    script = ('import matplotlib, sys; before = matplotlib.rcParams.copy(); '
              'from opencv_tools.robot.cli import robot_frames; '
              f'robot_frames([{str(ARM)!r}, "--conventions", {str(tmp_path / "arm.svg")!r}]); '
              'assert "matplotlib.pyplot" not in sys.modules; '
              'assert matplotlib.rcParams.copy() == before')
    subprocess.run([sys.executable, '-c', script], check=True, timeout=LONGEST_SECONDS)
