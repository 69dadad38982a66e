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

"""Picture of a robot: kinematic tree, title and unusual robots."""

from __future__ import annotations

from itertools import pairwise
import math
from pathlib import Path
import re

from drawn_robots import ARM, chain, drawn, marks, named, near, plotted, tutorial
from opencv_tools.robot.geometry import Capsule, Geometry, Mesh
from opencv_tools.robot.model import Link, MODEL, Placement, Robot
from opencv_tools.robot.pose import Pose
import pytest


def words(path: Path) -> list[str]:
    return re.findall(r'<text[^>]*>([^<]*)</text>', path.read_text())


def test_texts_of_the_tutorial_in_svg(tmp_path: Path) -> None:
    path = tmp_path / 'robot.svg'
    plotted(tutorial(), path)
    found = words(path)
    # In the perspective view, in the tree and in the side view.
    assert found.count('base_footprint') == 3
    assert found.count('base_link') == 3
    assert {'0.2', '0.15', '0.1', 'base_joint (fixed)', 'xyz 0 0 0.2', 'xyz 0 0 0', 'rpy 0 0 0',
            'visual of base_link (robot_base.stl)', 'collision of base_link (box)'} <= set(found)


def test_rows_of_the_kinematic_tree() -> None:
    tree = drawn(ARM)[1]
    spots = [(0.02, 0), (0.09, 1), (0.16, 2)]
    assert near(marks(tree, 'o'), spots)
    assert near([named(tree)[name] for name in ('base', 'arm', 'tool')],
                [(x + 0.022, y) for x, y in spots])
    assert near([line.get_xydata() for line in tree.lines if line.get_marker() == 'None'], [
        [(a, b + 0.2), (a, d), (c, d)] for (a, b), (c, d) in pairwise(spots)])
    joints = {one.get_text().strip(): (one.xycoords.get_text(), one.xy) for one in tree.texts
              if hasattr(one, 'xycoords')}
    assert joints == {'elbow (continuous)': ('arm', (1, 0.5)),
                      'slide (prismatic)': ('tool', (1, 0.5))}
    assert (tree.get_xlim(), tree.get_ylim()) == ((0, 1), (10, -0.5))


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(('count', 'bottom', 'height', 'rest'), [
    (5, 10, 7.65, {}), (40, 40, 10.75, {}), (62, 61, 15.55, {'and 2 more links': (0.02, 60)})])
def test_maximum_numbers_of_rows_and_names(
        count: int, bottom: float, height: float, rest: dict[str, tuple[float, float]]) -> None:
    space, tree = drawn(chain(count))
    rows = min(count, 60)
    step = min(0.07, 0.45 / (rows - 1))
    assert near(marks(tree, 'o'), [(0.02 + step * index, index) for index in range(rows)])
    assert tree.get_ylim() == (bottom, -0.5)
    assert space.figure.get_size_inches() == pytest.approx((13.0, height))
    named_links = sum(name.startswith('link_') for name in named(space))
    assert named_links == min(count, 40)
    assert (f'names of 40 of {count} links' in [text.get_text() for text in space.figure.texts]
            ) == (count > 40)
    assert {name: spot for name, spot in named(tree).items() if ' more ' in name} == rest


def test_side_view_only_for_small_robots() -> None:
    assert [len(drawn(chain(count))) for count in (1, 4, 5)] == [3, 3, 2]
    assert drawn(chain(4))[0].figure.get_size_inches() == pytest.approx((13.0, 10.45))


def test_positions_in_the_title() -> None:
    figure = drawn(chain(2), {'to_link_1': 0.5})[0].figure
    assert figure.texts[0].get_text() == 'robot chain at to_link_1=0.5'
    assert figure.texts[0].get_fontsize() == 14
    long = Robot(name='n' * 200, links=chain(1).links)
    title = drawn(long)[0].figure.texts[0]
    assert title.get_text() == f'robot {"n" * 141}...' and title.get_fontsize() < 14


def test_positions_in_the_picture() -> None:
    axes = drawn(ARM, {'elbow': math.pi / 2, 'slide': 0.1})
    lines = {line for part in (axes[0].figure, *axes) for text in part.texts
             for line in text.get_text().split('\n')}
    assert {'robot arm at elbow=1.5708, slide=0.1', '0.5', 'rpy 0 1.571 0', 'tool, moved'} <= lines


# A name with the characters of a formula, and as it is in SVG.
FORMULA, FORMULA_WORD = 'a$b$_{c} <&>', 'a$b$_{c} &lt;&amp;&gt;'


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('geometry', [
    Capsule(0.5, 1.0), Mesh('a.stl'), None])
def test_every_geometry_and_a_name_like_a_formula(
        tmp_path: Path, geometry: Geometry | None) -> None:
    path = tmp_path / 'robot.svg'
    plotted(tutorial(geometry, FORMULA), path)
    found = words(path)
    assert any(word.startswith(f'collision of {FORMULA_WORD}') for word in found)
    assert found.count(FORMULA_WORD) == 3


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('robot', [
    Robot(name='one', links=(Link(name='only', placement=Placement(Pose(), MODEL)),)),
    chain(4, Pose()),
    chain(5, Pose((1e-9, 0.0, 0.0))),
    chain(3, Pose((1e6, 0.0, 0.0))),
], ids=['one link', 'all in one place', 'tiny', 'huge'])
def test_no_warnings_for_unusual_robots(
        tmp_path: Path, robot: Robot, recwarn: pytest.WarningsRecorder) -> None:
    plotted(robot, tmp_path / 'robot.svg')
    # Those of Matplotlib and numpy; others, such as ResourceWarning, come from earlier tests.
    assert [one for one in recwarn.list
            if issubclass(one.category, (UserWarning, RuntimeWarning))] == []
