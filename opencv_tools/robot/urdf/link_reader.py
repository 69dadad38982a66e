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

"""What links of URDF consist of: mass, geometry and looks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from opencv_tools.robot.geometry import (
    BLACK, Box, Capsule, Color, Cylinder, Geometry, LIGHT_COLORS, Material, Mesh, Sphere)
from opencv_tools.robot.model import Extension, FrameId, Inertial, Placement, Shape
from opencv_tools.robot.pose import Pose, rotation_of_quaternion, Transform, ZERO
from opencv_tools.robot.xml.document import (
    AnyElement, DescriptionError, Element, line_of, local_name, required_child, required_name)
from opencv_tools.robot.xml.numbers import number, numbers, unclamped, vector
from opencv_tools.robot.xml.passthrough import extract_foreign, SDF_NAMESPACE
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.schema import INERTIA
from opencv_tools.robot.xml.tracked import TrackedElement

_SDF = f'{{{SDF_NAMESPACE}}}'
# The attribute that keeps a colour of which URDF took only a part.
CUT = f'{_SDF}rgba'


@dataclass(frozen=True)
class MaterialTable:
    """
    The materials of a file.

    :param each: by the elements of visuals.
    :param defined: colour and texture by name.
    :param single: the names that one element has and no other.
    """

    each: Mapping[TrackedElement, Material]
    defined: Mapping[str, Material]
    single: frozenset[str]


def origin_of(element: TrackedElement) -> Pose:
    """Read ``<origin>`` in an element; without one it is the identity."""
    origin = element.find('origin')
    if origin is None:
        return Pose()
    xyz = vector(origin.get('xyz'), origin, 'xyz') if 'xyz' in origin else ZERO
    rpy = vector(origin.get('rpy'), origin, 'rpy') if 'rpy' in origin else ZERO
    if 'quat_xyzw' not in origin:
        return Pose(xyz, rpy)
    x, y, z, w = numbers(origin.get('quat_xyzw'), 4, origin, 'quat_xyzw')
    if 'rpy' in origin or not any((x, y, z, w)):
        raise DescriptionError('quat_xyzw= has to be a rotation, and the only one', origin)
    return Transform(rotation_of_quaternion((w, x, y, z)), xyz).pose()


def inertial_from_element(element: TrackedElement, home: FrameId, report: Report, link: str
                          ) -> Inertial:
    """
    Read ``<inertial>``.

    :param home: the frame that URDF means by the link.
    :raises DescriptionError: the mass is not there.
    """
    mass, inertia = required_child(element, 'mass'), element.find('inertia')
    value = _number(mass, 'value')
    if value < 0:
        report.warn('mass', link, line_of(mass), f'value={mass.get("value")!r} is negative')
    missing = [name for name in INERTIA if inertia is None or name not in inertia]
    if inertia is None:
        report.warn('inertial', link, line_of(element), 'has no <inertia>; its moments are 0')
    elif missing:
        report.warn('inertia', link, line_of(inertia),
                    f'has no {", ".join(f"{name}=" for name in missing)}, taken for 0')
    ixx, ixy, ixz, iyy, iyz, izz = (
        0.0 if inertia is None or name in missing else _number(inertia, name) for name in INERTIA)
    return Inertial(Placement(origin_of(element), home), value, (ixx, ixy, ixz, iyy, iyz, izz))


def shapes_of(element: TrackedElement, tag: str, home: FrameId, looks: MaterialTable,
              report: Report) -> tuple[Shape, ...]:
    """
    Read each ``<visual>`` or ``<collision>`` of a link, and what the writer of URDF noted of one.

    What has no geometry that URDF knows is left out, and stays in the rest of the link.

    :param home: the frame that URDF means by the link.
    :param looks: see `collect_materials`.
    """
    link, shapes = required_name(element), []
    for child in element.take_all(tag, f'{_SDF}{tag}'):
        problem = _problem(child) if child.tag == tag else ''
        if problem:
            report.warn(tag, child.element.get('name') or link, line_of(child),
                        f'{problem}; it is left out')
            element.put_back(child)
        else:
            shapes.append(_shape(child, home, link, looks, report))
    return tuple(shapes)


def _problem(shape: TrackedElement) -> str:
    """Return why urdfdom has no such geometry; empty where it has."""
    geometry = shape.element.find('geometry')
    if geometry is None:
        return 'has no <geometry>'
    form = _forms(geometry)[:1]
    if not form:
        return 'has an empty <geometry>'
    tag = str(form[0].tag)
    if tag not in _GEOMETRIES:
        return f'<{tag}> is no geometry of URDF, which has {_KINDS}'
    return '<mesh> has no filename=' if tag == 'mesh' and 'filename' not in form[0].attrib else ''


def _forms(geometry: Element) -> list[Element]:
    return [child for child in geometry if not str(child.tag).startswith('{')]


def _shape(element: TrackedElement, home: FrameId, link: str, looks: MaterialTable,
           report: Report) -> Shape:
    tag = local_name(element)
    kept = extract_foreign(element, 'sdf')
    material = None
    if tag == 'visual':
        more = None if kept is None else TrackedElement(kept)
        material = _material(element, more, looks, report, link)
        kept = None if more is None else more.unread()
    geometry = None if element.tag != tag else _geometry(element, report, link)
    placement = Placement(origin_of(element), home)
    return Shape(element.get('name', ''), placement, geometry, material,
                 Extension(element.unread(), kept), line_of(element))


def _geometry(shape: TrackedElement, report: Report, link: str) -> Geometry:
    geometry = required_child(shape, 'geometry')
    first, *others = _forms(geometry.element)
    for other in others:
        report.warn(local_name(other), link, line_of(other),
                    'is not read, a geometry is one shape')
    form = required_child(geometry, str(first.tag))
    for name in ('size', 'radius', 'length'):
        text = form.element.get(name, '')
        if '-' in text and any(value < 0 for value in _floats(text)):
            report.warn(form.tag, link, line_of(form), f'{name}={text!r} is negative')
    scale = form.element.get('scale', '') if form.tag == 'mesh' else ''
    if len(scale.split()) == 1:
        report.warn('mesh', link, line_of(form), f'scale={scale!r} is one number, taken for all '
                    'three axes')
    return _GEOMETRIES[form.tag](form)


def _floats(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split()]
    except ValueError:  # which the reader of the geometry says better
        return []


def _box(element: TrackedElement) -> Box:
    return Box(vector(_attribute(element, 'size'), element, 'size'))


def _mesh(element: TrackedElement) -> Mesh:
    scale = element.get('scale')
    if scale is not None and len(scale.split()) == 1:
        scale = ' '.join([scale] * 3)
    return Mesh(_attribute(element, 'filename'),
                None if scale is None else vector(scale, element, 'scale'))


_GEOMETRIES: Mapping[str, Callable[[TrackedElement], Geometry]] = {
    'box': _box,
    'sphere': lambda element: Sphere(_number(element, 'radius')),
    'cylinder': lambda element: Cylinder(_number(element, 'radius'), _number(element, 'length')),
    'capsule': lambda element: Capsule(_number(element, 'radius'), _number(element, 'length')),
    'mesh': _mesh,
}
_KINDS = ', '.join(f'<{kind}>' for kind in _GEOMETRIES)


def collect_materials(root: TrackedElement, report: Report) -> MaterialTable:
    """
    Collect the materials that are defined, those of the robot first.

    A visual may name what another one defines, for urdfdom and RViz find that too.
    """
    each: dict[TrackedElement, Material] = {}
    found: dict[str, Material] = {}
    names: Counter[str] = Counter()
    visuals = [visual for tag in ('visual', f'{_SDF}visual') for link in root.take_all('link')
               for visual in link.take_all(tag)]
    # Those of the robot itself stay what they are, beside the visuals that name them.
    shared = map(TrackedElement, root.element.iterchildren('material'))
    for element in (*shared, *filter(None, (visual.find('material') for visual in visuals))):
        each[element] = look = read_material(element, report)
        names[look.name] += 1
        if look.name and (look.color or look.texture) and (
                found.setdefault(look.name, look) != look):
            report.warn('material', look.name, line_of(element), 'is defined elsewhere with '
                        'another colour or texture; each is taken as it stands')
    unique = frozenset(name for name, count in names.items() if count == 1)
    return MaterialTable(each, found, unique)


def restore_colors(root: Element) -> None:
    """Write colours as they were before `urdf_rules` took a part of them."""
    for color in root.iter('color'):
        if CUT in color.attrib:
            color.set('rgba', unclamped(color.get('rgba', ''), color.attrib.pop(CUT)))


def read_material(element: TrackedElement, report: Report) -> Material:
    """Read ``<material>``."""
    color, texture = element.find('color'), element.find('texture')
    name = (element.get('name') or '').strip()
    if texture is not None and not texture.element.get('filename'):
        report.warn('texture', name, line_of(texture), 'has no filename=; there is no picture')
        texture = None
    return Material(name, None if color is None else _color(color.get('rgba'), color, 'rgba'),
                    texture='' if texture is None else _attribute(texture, 'filename'))


def _material(visual: TrackedElement, kept: TrackedElement | None, looks: MaterialTable,
              report: Report, link: str) -> Material | None:
    """Read what a visual looks like, by its own definition or by the name of another one."""
    element = visual.find('material')
    lights = None if kept is None else kept.find('material')
    if element is None and lights is None:
        return None
    look = Material() if element is None else (
        looks.each.get(element) or read_material(element, report))
    if element is not None and look.name and not look.color and not look.texture:
        if look.name not in looks.defined and element.element.find('texture') is None:
            report.warn('material', look.name, line_of(element),
                        f'is not defined; the visual of link {link!r} has no colour')
        look = looks.defined.get(look.name, look)
    elif look.name in looks.single and look.name == material_name(link, visual.get('name', '')):
        look = replace(look, name='')  # the writer has to give one, and gives the same again
    if lights is not None:
        ambient, specular, emissive = (None if child is None else _color(child.text, child)
                                       for child in map(lights.find, LIGHT_COLORS))
        return replace(look, ambient=ambient, specular=specular, emissive=emissive)
    return with_default_lights(look)


def with_default_lights(look: Material) -> Material:
    """Give a material of URDF the lights that SDF tells apart from its colour."""
    if look.color is None:
        return look
    return Material(look.name, look.color, look.color, BLACK, BLACK, look.texture)


def material_name(link: str, visual: str) -> str:
    """Name the material of a visual that has none."""
    return f'{link}_{visual or "visual"}'


def _color(text: str | None, element: AnyElement, what: str = '') -> Color:
    red, green, blue, alpha = numbers(text, 4, element, what)
    return red, green, blue, alpha


def _attribute(element: AnyElement, name: str) -> str:
    value = element.get(name)
    if value is None:
        raise DescriptionError(f'has no {name}=', element)
    return value


def _number(element: TrackedElement, name: str) -> float:
    return number(_attribute(element, name), element, name)
