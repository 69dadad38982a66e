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

"""What the descriptions say of shapes, materials, axes and inertias, in the same words in both."""

from __future__ import annotations

from dataclasses import fields

from lxml import etree
from opencv_tools.robot.geometry import Color, DARK, LIGHT_COLORS, Material, Mesh
from opencv_tools.robot.model import Axis, Dynamics, Joint, Limit, Shape
from opencv_tools.robot.pose import normalised, Transform
from opencv_tools.robot.renaming import flat_name
from opencv_tools.robot.xml.document import local_name
from opencv_tools.robot.xml.numbers import UNLIMITED

Value = str | tuple[float, ...]
Facts = dict[str, Value]


def geometry_properties(shape: Shape) -> Facts:
    """Give what kind of shape it is, and its measures."""
    geometry = shape.geometry
    if geometry is None:
        return {'geometry': _carried_geometry(shape)}
    facts: Facts = {'geometry': type(geometry).__name__.lower()}
    if isinstance(geometry, Mesh):
        return {**facts, 'uri': _uri(geometry.uri), 'scale': geometry.scale or (1.0, 1.0, 1.0)}
    for part in fields(geometry):
        value = getattr(geometry, part.name)
        facts[part.name] = value if isinstance(value, tuple) else (value,)
    return facts


def _carried_geometry(shape: Shape) -> str:
    """Write what only SDF has, whatever its numbers look like."""
    rest = shape.extension.sdf
    parts = [] if rest is None else [part for whole in rest.iterfind('geometry')
                                     for part in whole.iter(etree.Element)]
    return ' '.join(f'{local_name(part)} {_meaning(part.text or "")}'.strip()
                    for part in parts[1:])


def _meaning(text: str) -> str:
    try:
        return ' '.join(repr(float(word)) for word in text.split())
    except ValueError:
        return text.strip()


def of_material(material: Material | None) -> Facts:
    """Give what can be seen of a material; of one that says nothing, nothing."""
    if material is None:
        return {}
    facts: Facts = {'color': material.color} if material.color else {}
    for what in LIGHT_COLORS:
        color: Color | None = getattr(material, what)
        if color is not None and color != DARK:
            facts[what] = color
    return {**facts, 'texture': _uri(material.texture)} if material.texture else facts


def _uri(uri: str) -> str:
    """Write both ways to name a file of a package as one."""
    return f'model://{uri[len("package://"):]}' if uri.startswith('package://') else uri


def axis_properties(axis: Axis, turn: Transform) -> Facts:
    """
    Give what an axis says.

    :param turn: from the joint's frame to the one in which the axis is given.
    """
    x, y, z = normalised(axis.xyz)
    limit, dynamics = axis.limit or Limit(), axis.dynamics or Dynamics()
    facts: Facts = {'axis': turn.rotate((x, y, z))}
    for what in ('lower', 'upper', 'effort', 'velocity'):
        value = getattr(limit, what)
        endless = abs(value) >= UNLIMITED or (what in ('effort', 'velocity') and value < 0)
        facts[what] = 'unlimited' if endless else (value,)
    facts.update(damping=(dynamics.damping or 0.0,), friction=(dynamics.friction or 0.0,))
    if axis.mimic:
        facts.update(mimics=flat_name(axis.mimic.joint), multiplier=(axis.mimic.multiplier,),
                     offset=(axis.mimic.offset,))
    return facts


def is_continuous(joint: Joint) -> bool:
    """Tell whether a joint turns without end, which SDF may call revolute."""
    return joint.type == 'continuous' or (
        joint.type == 'revolute' and min(-joint.limit.lower, joint.limit.upper) >= UNLIMITED)


def texts(a: Value, b: Value) -> tuple[str, str]:
    """Write both, so short that they can be read and so long that they are not the same."""
    short, full = ([fact if isinstance(fact, str) else ' '.join(map(form, fact))
                    for fact in (a, b)] for form in (_short, repr))
    return (short[0], short[1]) if short[0] != short[1] else (full[0], full[1])


def _short(value: float) -> str:
    # What is as small as this is what rounding leaves of a zero, unless it is what differs.
    return f'{value if abs(value) > 1e-12 else 0.0:.6g}'
