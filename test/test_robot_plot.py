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

from __future__ import annotations

from itertools import combinations, pairwise
import math
import os
from pathlib import Path
import re
import subprocess
import sys
from typing import Any

from opencv_tools.robot import drawing
from opencv_tools.robot.drawing import hull, outline
from opencv_tools.robot.model import Axis, FrameId, Joint, Link, MODEL, Placement, Robot, Shape
from opencv_tools.robot.plot import plot
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.shapes import Box, Capsule, Cylinder, Geometry, Mesh, Sphere
from opencv_tools.robot.xml import DescriptionError
import pytest


def on(link: str, pose: Pose = Pose()) -> Placement:  # noqa: B008
    return Placement(pose, FrameId('link', link))


BASE = Box((0.7, 0.3, 0.1))


def tutorial(geometry: Geometry | None = BASE, name: str = 'base_link') -> Robot:
    visual = Shape('', on(name, Pose((-0.1, 0.0, 0.0), (math.pi / 2, 0.0, math.pi / 2))),
                   Mesh('package://my_robot/meshes/robot_base.stl'))
    collision = Shape('', on(name, Pose((0.0, 0.0, -0.15))), geometry)
    return Robot('my_robot', (
        Link('base_footprint', Placement(Pose(), MODEL)),
        Link(name, Placement(Pose(), FrameId('joint', 'base_joint')), None, (visual,),
             (collision,))), (
        Joint('base_joint', 'fixed', 'base_footprint', name,
              on('base_footprint', Pose((0.0, 0.0, 0.2)))),))


def chain(count: int, pose: Pose = Pose((0.1, 0.0, 0.1), (0.0, 0.3, 0.5))) -> Robot:  # noqa: B008
    names = [f'link_{index}' for index in range(count)]
    return Robot('chain', (Link(names[0], Placement(Pose(), MODEL)), *(
        Link(name, Placement(Pose(), FrameId('joint', f'to_{name}'))) for name in names[1:])),
        tuple(Joint(f'to_{child}', 'continuous', parent, child, on(parent, pose),
                    (Axis((0.0, 0.0, 1.0)),)) for parent, child in pairwise(names)))


def words(path: Path) -> list[str]:
    return re.findall(r'<text[^>]*>([^<]*)</text>', path.read_text())


def test_a_png_is_a_picture_with_colours(tmp_path: Path) -> None:
    from matplotlib.image import imread
    path = tmp_path / 'robot.PNG'
    plot(tutorial(), {}, str(path))
    picture = imread(path)
    assert picture.shape[0] > 800
    assert picture.shape[1] > 1200
    for color in drawing.AXIS_COLORS:
        wanted = [int(color[start:start + 2], 16) / 255 for start in (1, 3, 5)]
        assert (abs(picture[..., :3] - wanted).max(axis=2) < 0.02).sum() > 100


def test_the_tutorials_schematic_has_names_and_sizes(tmp_path: Path) -> None:
    path = tmp_path / 'robot.svg'
    plot(tutorial(), {}, str(path))
    found = words(path)
    # In the view in space, in the tree and in the schematic.
    assert found.count('base_footprint') == 3
    assert found.count('base_link') == 3
    assert {'0.2', '0.15', '0.1', 'base_joint (fixed)', 'xyz 0 0 0.2', 'rpy 0 0 0',
            'visual of base_link (robot_base.stl)', 'collision of base_link (box)'} <= set(found)


def test_the_file_is_the_same_every_time_and_has_no_date(tmp_path: Path) -> None:
    one, other = tmp_path / 'one.svg', tmp_path / 'other.svg'
    for path in (one, other):
        plot(tutorial(), {}, str(path))
    assert one.read_bytes() == other.read_bytes()
    assert '<dc:date>' not in one.read_text()


def test_positions_are_shown(tmp_path: Path) -> None:
    one, other = tmp_path / 'one.svg', tmp_path / 'other.svg'
    plot(chain(3), {}, str(one))
    plot(chain(3), {'to_link_1': 0.5}, str(other))
    assert 'chain   to_link_1 = 0.5' in words(other)
    assert one.read_text() != other.read_text()


def test_many_links_have_no_schematic_and_names_that_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / 'robot.svg'
    plot(chain(62), {}, str(path))
    found = words(path)
    assert 'and 2 more links' in found
    assert 'names of 40 of 62 links' in found
    assert not any(word.startswith('Side view') for word in found)


def test_names_do_not_lie_on_one_another() -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    figure = Figure(figsize=(8, 6))
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    canvas.draw()
    labels = drawing.Labels(axes)
    labels.avoid((0.0, 0.5), (1.0, 0.5))
    for index in range(12):
        labels.place(f'a_long_name_{index}', (0.5, 0.5))
    texts = [text for text in axes.texts if text.get_text()]
    canvas.draw()
    from matplotlib.text import Text
    boxes = [Text.get_window_extent(text, canvas.get_renderer()) for text in texts]
    assert len(boxes) == 12
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)
    line = axes.transData.transform((0.5, 0.5))[1]
    assert not any(box.y0 < line < box.y1 for box in boxes)


@pytest.mark.parametrize('geometry', [
    Capsule(0.5, 1.0), Mesh('a.stl'), None])
def test_any_geometry_is_drawn(tmp_path: Path, geometry: Geometry | None) -> None:
    path = tmp_path / 'robot.svg'
    plot(tutorial(geometry), {}, str(path))
    assert any(word.startswith('collision of base_link') for word in words(path))


@pytest.mark.parametrize(('geometry', 'size'), [
    (Box((1.0, 2.0, 3.0)), (1.0, 2.0, 3.0)), (Sphere(1.0), (2.0, 2.0, 2.0)),
    (Cylinder(0.5, 1.0), (1.0, 1.0, 1.0)), (Capsule(0.5, 1.0), (1.0, 1.0, 2.0))])
def test_outlines_are_as_large_as_the_shapes(geometry: Geometry, size: tuple[float, ...]) -> None:
    columns = zip(*(point for line in outline(geometry) for point in line))
    assert tuple(max(column) - min(column) for column in columns) == pytest.approx(size)


def test_a_hull_goes_round_its_points() -> None:
    corners = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)]
    assert hull([*corners, (1.0, 0.5), (1.0, 0.0), (2.0, 1.0)]) == corners
    assert hull([(1.0, 1.0)]) == [(1.0, 1.0)]
    assert sorted(hull([(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)])) == [(0.0, 0.0), (2.0, 2.0)]


@pytest.mark.parametrize('robot', [
    Robot('one', (Link('only', Placement(Pose(), MODEL)),)),
    chain(4, Pose()),
    chain(5, Pose((1e-9, 0.0, 0.0))),
    chain(3, Pose((1e6, 0.0, 0.0))),
], ids=['one link', 'all in one place', 'tiny', 'huge'])
def test_odd_robots_are_drawn_without_a_warning(
        tmp_path: Path, robot: Robot, recwarn: pytest.WarningsRecorder) -> None:
    plot(robot, {}, str(tmp_path / 'robot.svg'))
    assert not recwarn.list


def test_names_are_no_formulas(tmp_path: Path) -> None:
    path = tmp_path / 'robot.svg'
    plot(tutorial(name='a$b$_{c} <&>'), {}, str(path))
    assert words(path).count('a$b$_{c} &lt;&amp;&gt;') == 3


@pytest.mark.parametrize('name', ['robot.pdf', 'robot', 'png'])
def test_another_suffix_is_an_error(tmp_path: Path, name: str) -> None:
    with pytest.raises(DescriptionError, match=r'a picture is \.png or \.svg, not'):
        plot(tutorial(), {}, str(tmp_path / name))
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match='cannot be written: No such file'):
        plot(tutorial(), {}, str(tmp_path / 'nowhere' / 'robot.svg'))


def test_without_matplotlib_the_error_says_how_to_get_it(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, 'matplotlib', None)
    with pytest.raises(DescriptionError, match='pip install matplotlib` or `sudo apt'):
        plot(tutorial(), {}, str(tmp_path / 'robot.png'))


def test_neither_matplotlib_nor_numpy_is_imported_before_it_is_needed() -> None:
    script = ('import sys, opencv_tools.robot.plot; '
              'assert not {"matplotlib", "numpy"} & set(sys.modules)')
    subprocess.run([sys.executable, '-c', script], check=True, timeout=30)


def test_neither_a_figure_nor_a_setting_stays(tmp_path: Path) -> None:
    script = ('import matplotlib, sys; before = matplotlib.rcParams.copy(); '
              'from test_robot_plot import plot, tutorial; '
              f'plot(tutorial(), {{}}, {str(tmp_path / "robot.svg")!r}); '
              'assert "matplotlib.pyplot" not in sys.modules; '
              'assert matplotlib.rcParams.copy() == before')
    paths = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    subprocess.run([sys.executable, '-c', script], check=True, timeout=60,
                   env={**os.environ, 'PYTHONPATH': paths})
