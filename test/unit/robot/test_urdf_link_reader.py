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

"""Reader of URDF links: geometries and inertials."""

from __future__ import annotations

from opencv_tools.robot.geometry import Box, Capsule, Cylinder, Geometry, Mesh, Sphere
from opencv_tools.robot.xml.report import Report
from rows import each_row
from urdf_models import BOX, check_error, read, round_trip, visual, written


@each_row(('content', 'location', 'message'), [
    (visual('<geometry>\n<box/></geometry>'), '2: <box>', 'has no size='),
    (visual('<geometry>\n<box size="1 1"/></geometry>'), '2: <box>', "size='1 1'"),
    (visual('<geometry>\n<box size="x 1 1"/></geometry>'), '2: <box>', "size='x 1 1'"),
    (visual('<geometry>\n<cylinder radius="1"/></geometry>'), '2: <cylinder>', 'has no length='),
    (visual('<geometry>\n<mesh filename="a" scale="1 1"/></geometry>'), '2: <mesh>',
     "scale='1 1'"),
    ('<link name="a">\n<inertial><inertia/></inertial></link>', '2: <inertial>',
     'has no <mass>'),
    ('<link name="a"><inertial>\n<mass/><inertia/></inertial></link>', '2: <mass>',
     'has no value='),
    ('<link name="a"><inertial><mass value="1"/>\n<inertia ixx="x"/></inertial></link>',
     '2: <inertia>', "ixx='x'"),
])
def test_errors(content: str, location: str, message: str) -> None:
    check_error(content, location, message)


@each_row('content', [
    '', '<geometry/>', '<geometry><cone/></geometry>', '<geometry><cone/><box/></geometry>',
    '<geometry><mesh scale="1 1 1"/></geometry>',
])
@each_row('tag', ['visual', 'collision'])
def test_shape_without_a_valid_geometry_is_preserved(content: str, tag: str) -> None:
    report = Report()
    model = read(visual(f'<origin xyz="0 0 1"/>{content}</{tag}><{tag}>{BOX}', tag), report)
    (link,) = model.links
    assert [note.element for note in report.warnings if note.element != 'cone'] == [tag]
    assert f'the {tag} is left out' in report.warnings[0].message
    (shape,) = getattr(link, f'{tag}s')
    assert isinstance(shape.geometry, Box)
    left = next(iter(written(model).iterfind(f'link/{tag}[2]')))
    assert left.find('origin') is not None
    assert (left.find('geometry') is None) == (not content)


def test_missing_moments_of_inertia_are_zero() -> None:
    for inertia in ('', '<inertia/>', '<inertia ixy="0" iyy="0"/>'):
        link, = read(f'<link name="a"><inertial><mass value="2"/>{inertia}</inertial></link>'
                     ).links
        assert link.inertial
        assert (link.inertial.mass, link.inertial.inertia) == (2.0, (0.0,) * 6)


def test_scale_of_one_number() -> None:
    model = read(visual('<geometry><mesh filename="a" scale="0.5"/></geometry>'))
    assert model.links[0].visuals[0].geometry == Mesh('a', (0.5, 0.5, 0.5))


def test_sizes_of_zero() -> None:
    report = Report()
    read(visual('<geometry><box size="0 0 0"/></geometry>'), report)
    assert not report.notes


def test_foreign_elements_beside_a_geometry() -> None:
    model = read(visual('<geometry><sdf:cone/><sphere radius="0.1"/><sdf:plane/></geometry>'))
    for made in (model, round_trip(model)):
        shape, = made.links[0].visuals
        assert shape.geometry == Sphere(0.1) and shape.extension.urdf is not None
        assert [child.tag for child in shape.extension.urdf.find('geometry')] == [  # type: ignore
            '{urn:opencv_tools:sdf}cone', '{urn:opencv_tools:sdf}plane']


@each_row(('radius', 'length', 'expected'), [
    (0.25, 1.0, Capsule(0.25, 0.5)), (0.25, 1.5, Cylinder(0.25, 1.5)),
    (0.3, 1.0, Cylinder(0.3, 1.0))])
def test_preserved_capsule_of_an_edited_cylinder(
        radius: float, length: float, expected: Geometry) -> None:
    report = Report()
    model = read(visual(
        f'<geometry><cylinder radius="{radius}" length="{length}"/><capsule radius="0.25" '
        'length="0.5" xmlns="urn:opencv_tools:sdf"/></geometry>'), report)
    assert model.links[0].visuals[0].geometry == expected
    assert len(report.warnings) == isinstance(expected, Cylinder)
