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

"""From a robot as it was read to the XML of the other format."""

from __future__ import annotations

from dataclasses import replace

from opencv_tools.robot.geometry import Mesh
from opencv_tools.robot.lump import lump_fixed
from opencv_tools.robot.model import FrameId, Inertial, Placement, Robot, Shape
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.renaming import (
    with_original_names, with_valid_sdf_names, with_valid_urdf_names)
from opencv_tools.robot.sdf.rules import keep_sdf_rules, report_inertials
from opencv_tools.robot.sdf.values import FRAMES, written_version
from opencv_tools.robot.sdf.writer import write_sdf
from opencv_tools.robot.trees import select_root, shortened
from opencv_tools.robot.urdf.rules import keep_urdf_rules
from opencv_tools.robot.urdf.writer import write_urdf
from opencv_tools.robot.xml.document import DescriptionError, Element
from opencv_tools.robot.xml.report import Report

# What a link without <inertial> gets.
INERTIALS = {
    'keep': None,
    'zero': (0.0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    # What simulators take an SDF link for that does not say.
    'default': (1.0, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
}
_SCHEMES = ('package://', 'model://')


def convert_to_sdf(robot: Robot, report: Report, *, version: str = '1.11',
                   relative: bool = False, inertial: str = 'keep', lump: bool = False,
                   mesh_uri: str = 'model') -> Element:
    """
    Write a robot as SDF.

    :param version: of SDF, ``1.4`` to ``1.12``.
    :param relative: whether each link is placed in the one it hangs on, its numbers untouched,
        and not in the frame of the model, as the tutorial does.
    :param inertial: a key of ``INERTIALS``.
    :param lump: whether links that fixed joints hold together become one.
    :param mesh_uri: ``model``, ``package`` or ``keep``, see `with_mesh_uris`.
    :returns: the element ``<sdf>``.
    :raises DescriptionError: it cannot be written so.
    """
    if lump:
        if written_version(version) < FRAMES:
            raise DescriptionError(f'--fixed lump leaves frames, which SDF {version} has not; '
                                   f'take {FRAMES} or newer', source=robot.source)
        robot = lump_fixed(robot, report)
    robot = with_mesh_uris(with_inertials(robot, inertial, report), mesh_uri)
    report_inertials(robot, report)
    robot = with_valid_sdf_names(robot, report)
    root = write_sdf(robot, report, version=version, relative=relative)
    keep_sdf_rules(root, robot.source, report)
    return root


def convert_to_urdf(robot: Robot, report: Report, *, inertial: str = 'keep',
                    mesh_uri: str = 'package') -> Element:
    """
    Write a robot as URDF.

    :param inertial: a key of ``INERTIALS``.
    :param mesh_uri: ``model``, ``package`` or ``keep``, see `with_mesh_uris`.
    :returns: the element ``<robot>``.
    :raises DescriptionError: it cannot be written so.
    """
    robot = with_inertials(select_root(robot, '', report), inertial, report)
    robot = with_mesh_uris(robot, mesh_uri)
    root = write_urdf(with_original_names(with_valid_urdf_names(robot, report)), report)
    keep_urdf_rules(root, robot.source, report)
    return root


def with_inertials(robot: Robot, choice: str, report: Report) -> Robot:
    """
    Say what links weigh that do not say it themselves.

    :param choice: a key of ``INERTIALS``; with ``keep`` they stay as they are, and are reported.
    """
    silent = [link for link in robot.links if link.inertial is None and not link.is_world]
    values = INERTIALS[choice]
    if values is None:
        if silent:
            report.warn('link', silent[0].name, silent[0].line, (
                f'{shortened([link.name for link in silent])} without <inertial>: URDF means no '
                'mass, SDF 1 kg; --inertial zero or default writes which'))
        return robot
    return replace(robot, links=tuple(
        replace(link, inertial=Inertial(Placement(Pose(), FrameId('link', link.name)), *values))
        if link.inertial is None and not link.is_world else link for link in robot.links))


def with_mesh_uris(robot: Robot, choice: str) -> Robot:
    """
    Write the places of meshes and textures as the other format does.

    :param choice: ``package`` or ``model`` for ``package://`` or ``model://`` wherever the other
        one stands; ``keep`` for what stands there.
    """
    if choice == 'keep':
        return robot
    new = f'{choice}://'
    old, = {*_SCHEMES} - {new}

    def shape(one: Shape) -> Shape:
        if isinstance(one.geometry, Mesh) and one.geometry.uri.startswith(old):
            uri = new + one.geometry.uri[len(old):]
            one = replace(one, geometry=replace(one.geometry, uri=uri))
        if one.material and one.material.texture.startswith(old):
            texture = new + one.material.texture[len(old):]
            one = replace(one, material=replace(one.material, texture=texture))
        return one

    return replace(robot, links=tuple(
        replace(link, visuals=tuple(map(shape, link.visuals)),
                collisions=tuple(map(shape, link.collisions))) for link in robot.links))
