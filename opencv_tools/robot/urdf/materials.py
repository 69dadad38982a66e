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

"""Materials of URDF, read and written. A material name stands for one colour and texture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

from lxml import etree
from opencv_tools.robot.geometry import BLACK, Color, LIGHT_COLORS, Material
from opencv_tools.robot.model import Link, Robot, Shape
from opencv_tools.robot.names import Names
from opencv_tools.robot.xml.document import (
    AnyElement, Element, line_of, PARTLY_READ, required_attribute, TrackedElement)
from opencv_tools.robot.xml.numbers import numbers, numbers_text
from opencv_tools.robot.xml.passthrough import merge_unread, SDF_TAG
from opencv_tools.robot.xml.report import Report

_Appearance = tuple[Color | None, str]  # colour and texture


@dataclass(frozen=True)
class MaterialTable:
    """
    The materials of a file.

    :param defined: materials that have a colour or a texture, by name.
    :param single: names that only one element has.
    """

    by_element: Mapping[TrackedElement, Material]
    defined: Mapping[str, Material]
    single: frozenset[str]


def collect_materials(root: TrackedElement, report: Report) -> MaterialTable:
    """
    Read all materials, those of the robot before those of visuals.

    A visual may name a material that another visual defines, because urdfdom and RViz find it.
    """
    by_element: dict[TrackedElement, Material] = {}
    defined: dict[str, Material] = {}
    counts: Counter[str] = Counter()
    visuals = [visual for tag in ('visual', f'{SDF_TAG}visual')
               for link in root.take_all('link') for visual in link.take_all(tag)]
    # Materials of the robot stay unread, so that the writer adds them again.
    shared = map(TrackedElement, root.element.iterchildren('material'))
    for element in (*shared, *filter(None, (visual.find('material') for visual in visuals))):
        by_element[element] = material = read_material(element, report)
        counts[material.name] += 1
        if material.name and (material.color or material.texture) and (
                defined.setdefault(material.name, material) != material):
            report.warn('material', material.name, line_of(element), 'has another colour or '
                        'texture elsewhere in the file; each visual keeps its own')
    single = frozenset(name for name, count in counts.items() if count == 1)
    return MaterialTable(by_element, defined, single)


def read_material(element: TrackedElement, report: Report) -> Material:
    """Read ``<material>``."""
    color, texture = element.find('color'), element.find('texture')
    name = (element.get('name') or '').strip()
    if texture is not None and not texture.element.get('filename'):
        report.warn('texture', name, line_of(texture), 'has no filename=; the texture is ignored')
        texture = None
    return Material(name=name,
                    color=None if color is None else _color(color.get('rgba'), color, 'rgba'),
                    texture='' if texture is None else required_attribute(texture, 'filename'))


def visual_material(visual: TrackedElement, preserved: TrackedElement | None,
                    table: MaterialTable, report: Report, link: str) -> Material | None:
    """
    Return the material of a visual, by its own definition or by the name of another one.

    :param preserved: the SDF of the visual, which may have more colours.
    """
    element = visual.find('material')
    lights = None if preserved is None else preserved.find('material')
    if element is None and lights is None:
        return None
    material = Material() if element is None else (
        table.by_element.get(element) or read_material(element, report))
    if element is not None and material.name and not material.color and not material.texture:
        if material.name not in table.defined and element.element.find('texture') is None:
            report.warn('material', material.name, line_of(element),
                        f'is not defined; the visual of link {link!r} has no colour')
        material = table.defined.get(material.name, material)
    elif (material.name in table.single
          and material.name == _default_name(link, visual.get('name', ''))):
        material = replace(material, name='')  # the writer creates the same name again
    if lights is None:
        return with_default_lights(material)
    ambient, specular, emissive = (None if child is None else _color(child.text, child)
                                   for child in map(lights.find, LIGHT_COLORS))
    return replace(material, ambient=ambient, specular=specular, emissive=emissive)


def with_default_lights(material: Material) -> Material:
    """Return a material of URDF with the other colours of SDF that follow from its colour."""
    if material.color is None:
        return material
    return replace(material, ambient=material.color, specular=BLACK, emissive=BLACK)


def with_block_colors(visual: Shape, colors: Mapping[str, Color], link: str, report: Report
                      ) -> Shape:
    """Return a visual with the colours of ``<gazebo>``, of which two replace its own ones."""
    if not colors:
        return visual
    material = visual.material or Material()
    if material.color and colors.keys() & {'color', 'ambient'}:
        report.warn('material', link, visual.line, f'rgba={numbers_text(material.color)!r} has no '
                    'effect in Gazebo: the <material> of <gazebo> replaces it')
        material = Material(texture=material.texture)
    return replace(visual, material=Material(**{**vars(material), **colors}))


@dataclass
class MaterialNames:
    """
    The names of materials in a file that is written.

    :param appearances: colour and texture by name.
    """

    appearances: dict[str, _Appearance]
    taken: Names

    @classmethod
    def of(cls, robot: Robot) -> MaterialNames:
        """Collect the materials of visuals, and those that the file has outside its links."""
        shapes = (shape for link in robot.links for shape in link.visuals)
        names = {shape.material.name for shape in shapes if shape.material}
        unread = robot.extension.urdf
        shared = [] if unread is None else [read_material(TrackedElement(element), Report())
                                            for element in unread.iterfind('material')]
        appearances = {material.name: (material.color, material.texture)
                       for material in reversed(shared) if material.name}
        return cls(appearances, Names((*names, *appearances)))

    def name_for(self, material: Material, link: Link, shape: Shape, report: Report) -> str:
        """Return a name that no other colour or texture has."""
        appearance = (material.color, material.texture)
        if material.name and self.appearances.setdefault(material.name, appearance) == appearance:
            return material.name
        name = self.taken.new(_default_name(link.name, shape.name))
        if material.name:
            report.warn('material', material.name, shape.line, f'renamed to {name!r}, because the '
                        'name has another colour or texture elsewhere')
        return name


def material_element(visual: Element, material: Material, shape: Shape, link: Link,
                     names: MaterialNames, report: Report) -> None:
    """Write ``<material>`` into a visual, if URDF can express any of it."""
    if not material.name and not material.color and not material.texture:
        return
    element = etree.SubElement(visual, 'material',
                               name=names.name_for(material, link, shape, report))
    if material.color:
        etree.SubElement(element, 'color', rgba=numbers_text(material.color))
    if material.texture:
        etree.SubElement(element, 'texture', filename=material.texture)


def with_lights(unread: Element | None, material: Material) -> Element | None:
    """Return the SDF of a visual with the colours that do not follow from the URDF colour."""
    has_unread = unread is not None and unread.find('material') is not None
    is_in_urdf = material.name or material.color or material.texture
    if is_in_urdf and not has_unread and material == with_default_lights(material):
        return unread
    visual = etree.Element('visual')
    element = etree.SubElement(visual, 'material', {PARTLY_READ: 'true'})
    for tag in LIGHT_COLORS:
        color: Color | None = getattr(material, tag)
        if color:
            etree.SubElement(element, tag).text = numbers_text(color)
    merge_unread(visual, unread, marked=True)
    return visual


def _default_name(link: str, visual: str) -> str:
    """Return the name of a material without a name."""
    return f'{link}_{visual or "visual"}'


def _color(text: str | None, element: AnyElement, attribute: str = '') -> Color:
    red, green, blue, alpha = numbers(text, 4, element, attribute)
    return red, green, blue, alpha
