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

"""Properties of shapes, materials and joints that do not depend on the format."""

from __future__ import annotations

import random

from lxml import etree
from opencv_tools.robot.geometry import BLACK, LIGHT_COLORS, Material, Mesh
from opencv_tools.robot.model import Axis, Dynamics, Joint, Limit, Shape
from opencv_tools.robot.names import flat_name
from opencv_tools.robot.pose import normalised, Transform
from opencv_tools.robot.xml.document import local_name
from opencv_tools.robot.xml.numbers import UNLIMITED

# Limits farther from zero than this are ignored, because far poses hide small differences.
_FAR = 1000.0
Value = str | tuple[float, ...]
Properties = dict[str, Value]


def geometry_properties(shape: Shape) -> Properties:
    """Return the kind and the dimensions of a shape."""
    geometry = shape.geometry
    if geometry is None:
        return {'geometry': _sdf_geometry(shape)}
    properties: Properties = {'geometry': type(geometry).__name__.lower()}
    if isinstance(geometry, Mesh):
        return {**properties, 'uri': plain_uri(geometry.uri),
                'scale': geometry.scale or (1.0, 1.0, 1.0)}
    for dimension, value in vars(geometry).items():
        properties[dimension] = value if isinstance(value, tuple) else (value,)
    return properties


def _sdf_geometry(shape: Shape) -> str:
    """Return a geometry that only SDF has as text, with its numbers in one format."""
    root = shape.extension.sdf
    elements = [] if root is None else [element for geometry in root.iterfind('geometry')
                                        for element in geometry.iter(etree.Element)]
    return ' '.join(f'{local_name(element)} {_plain_numbers(element.text or "")}'.strip()
                    for element in elements[1:])


def _plain_numbers(text: str) -> str:
    try:
        return ' '.join(repr(float(word)) for word in text.split())
    except ValueError:
        return text.strip()


def material_properties(material: Material | None) -> Properties:
    """Return the visible properties of a material, without those that have default values."""
    if material is None:
        return {}
    properties: Properties = {'color': material.color} if material.color else {}
    for name in LIGHT_COLORS:
        color = getattr(material, name)
        if color not in (None, BLACK):
            properties[name] = color
    if material.texture:
        properties['texture'] = plain_uri(material.texture)
    return properties


def plain_uri(uri: str) -> str:
    """Return a URI of a file in a package with one scheme for both formats."""
    return f'model://{uri[len("package://"):]}' if uri.startswith('package://') else uri


def axis_properties(axis: Axis, pose: Transform) -> Properties:
    """
    Return the direction, limits, dynamics and mimic of an axis.

    :param pose: pose of the joint in the frame in which the direction is returned.
    """
    x, y, z = normalised(axis.xyz)
    limit, dynamics = axis.limit or Limit(), axis.dynamics or Dynamics()
    properties: Properties = {'axis': pose.rotate((x, y, z))}
    for name, value in vars(limit).items():
        unlimited = abs(value) >= UNLIMITED or (name in ('effort', 'velocity') and value < 0)
        properties[name] = 'unlimited' if unlimited else (value,)
    properties.update(damping=(dynamics.damping or 0.0,), friction=(dynamics.friction or 0.0,))
    if axis.mimic:
        properties.update(mimics=flat_name(axis.mimic.joint), offset=(axis.mimic.offset,),
                          multiplier=(axis.mimic.multiplier,))
    return properties


def is_continuous(joint: Joint) -> bool:
    """Return whether a joint is continuous; in SDF it may be a revolute joint without limits."""
    return joint.type == 'continuous' or (
        joint.type == 'revolute' and min(-joint.limit.lower, joint.limit.upper) >= UNLIMITED)


def format_pair(a: Value, b: Value) -> tuple[str, str]:
    """Return two values as text, with as many digits as necessary to see that they differ."""
    short, full = ([value if isinstance(value, str) else ' '.join(map(text, value))
                    for value in (a, b)] for text in (_short, repr))
    return (short[0], short[1]) if short[0] != short[1] else (full[0], full[1])


def _short(value: float) -> str:
    # A value as small as this is a rounding error of zero.
    return f'{value if abs(value) > 1e-12 else 0.0:.6g}'


def random_position(joint: Joint, generator: random.Random) -> list[float]:
    """Return a random position of a joint within its limits, for `joint_transform`."""
    return [generator.uniform(*limits) for limits in _limits(joint)]


def _limits(joint: Joint) -> list[tuple[float, float]]:
    kind = joint.kind
    limits = [axis.limit or Limit() for axis in joint.axes[:kind.axes]
              if joint.has_position_limits]
    limits += [Limit()] * (kind.dof - len(limits))
    return [_finite(limit, span) for limit, span in zip(limits, kind.random_span)]


def _finite(limit: Limit, span: float) -> tuple[float, float]:
    lower, upper = limit.lower, limit.upper
    if abs(lower) > _FAR:
        lower = -span if abs(upper) > _FAR else min(-span, upper - span)
    return lower, max(span, lower + span) if abs(upper) > _FAR else upper
