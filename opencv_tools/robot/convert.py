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

"""Conversion of a robot to the XML of the other format."""

from __future__ import annotations

from dataclasses import dataclass, replace

from opencv_tools.robot.geometry import Mesh
from opencv_tools.robot.lumping import (
    is_massless, lump_fixed, marked_massless, with_massless, without_massless)
from opencv_tools.robot.model import FrameId, Inertial, Link, Placement, Robot, Shape
from opencv_tools.robot.physical import (
    report_inertials, with_physical_inertials, without_zero_masses)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.renaming import (
    with_original_names, with_valid_sdf_names, with_valid_urdf_names)
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.sdf.rules import keep_sdf_rules
from opencv_tools.robot.sdf.values import DEFAULT_INERTIAL, MODEL_PARTS
from opencv_tools.robot.sdf.writer import write_sdf
from opencv_tools.robot.trees import (
    select_root, shortened, with_bare_world, with_frame_links, with_world_link)
from opencv_tools.robot.urdf.rules import keep_urdf_rules
from opencv_tools.robot.urdf.versions import written_version
from opencv_tools.robot.urdf.writer import write_urdf
from opencv_tools.robot.xml.document import Element
from opencv_tools.robot.xml.report import Report

# Mass and moments of inertia of links without <inertial>.
INERTIALS = {
    'same': None,
    'keep': None,
    'physical': None,
    'zero': (0.0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    'default': DEFAULT_INERTIAL,
}
_SIMULATED = ('same', 'physical')  # choices that keep what a simulator takes
_SCHEMES = {'model': 'model://', 'package': 'package://'}


@dataclass(frozen=True, kw_only=True)
class SdfOptions:
    """
    Options for writing a robot as SDF.

    :param version: SDF version, ``1.7`` to ``1.12``.
    :param relative: whether the pose of each link is relative to its parent link, with the
        numbers of the file; otherwise poses are relative to the model, as in the tutorial.
    :param inertial: a key of ``INERTIALS``.
    :param fixed: ``frames`` for frames in place of links without mass on fixed joints if
        ``inertial`` is ``same`` or ``physical``; ``keep`` for all links; ``lump`` to merge all
        links on fixed joints.
    :param mesh_uri: ``model``, ``package`` or ``keep``, see `with_mesh_uris`.
    """

    version: str = '1.11'
    relative: bool = False
    inertial: str = 'same'
    fixed: str = 'frames'
    mesh_uri: str = 'model'


@dataclass(frozen=True, kw_only=True)
class UrdfOptions:
    """
    Options for writing a robot as URDF.

    :param version: version of URDF, ``1.0``, ``1.1`` or ``1.2``; empty for that of the URDF
        that the robot comes from, or else ``1.0``.
    :param inertial: a key of ``INERTIALS``.
    :param frame_links: whether the frames become links, see `trees.with_frame_links`.
    :param world_link: link to which all root links are fixed, see `trees.with_world_link`; empty
        for a robot with one root link.
    :param mesh_uri: ``model``, ``package`` or ``keep``, see `with_mesh_uris`.
    """

    version: str = ''
    inertial: str = 'same'
    frame_links: bool = False
    world_link: str = ''
    mesh_uri: str = 'package'


def convert_to_sdf(robot: Robot, report: Report, options: SdfOptions = SdfOptions()) -> Element:
    """
    Return a robot as SDF.

    :returns: the element ``<sdf>``.
    :raises DescriptionError: SDF of this version does not support the robot.
    """
    robot = without_zero_masses(robot, report)
    if options.fixed != 'keep':
        robot = with_bare_world(robot, report)
    if options.fixed == 'lump':
        robot = lump_fixed(robot, report)
    robot = with_valid_sdf_names(robot, report)
    if options.fixed == 'frames' and options.inertial in _SIMULATED:
        robot = without_massless(robot, report)
    robot = marked_massless(robot)
    robot = with_mesh_uris(with_inertials(robot, options.inertial, report), options.mesh_uri)
    report_inertials(robot, report)
    root = write_sdf(robot, report, version=options.version, relative=options.relative)
    keep_sdf_rules(root, robot.source, report)
    return root


def convert_to_urdf(robot: Robot, report: Report, options: UrdfOptions = UrdfOptions()
                    ) -> Element:
    """
    Return a robot as URDF.

    :returns: the element ``<robot>``.
    :raises DescriptionError: URDF does not support the robot.
    """
    robot = with_inertials(robot, options.inertial, report)
    if options.world_link:
        robot = with_world_link(robot, options.world_link)
    robot = with_massless(select_root(robot, '', report))
    report_inertials(robot, report)
    robot = with_mesh_uris(robot, options.mesh_uri)
    if options.frame_links:
        robot = with_frame_links(robot, report)
    robot = with_original_names(with_valid_urdf_names(robot, report))
    version = written_version(robot.extension.urdf, options.version)
    root = write_urdf(robot, report, version)
    keep_urdf_rules(root, robot.source, report, version)
    return root


def with_model_parts(robot: Robot) -> Robot:
    """
    Return a robot with the links, joints and frames that its ``<gazebo>`` adds to the model.

    Such a link without an inertial has the mass that simulators give it, beside links with mass.
    """
    if all(robot.extension.find_sdf(tag) is None for tag in MODEL_PARTS):
        return robot
    root = convert_to_sdf(robot, Report(), SdfOptions(
        relative=True, inertial='keep', fixed='keep', mesh_uri='keep'))
    root.getroottree().docinfo.URL = robot.source  # for errors
    whole = with_original_names(read_sdf(root, Report()))
    own = {link.name for link in robot.links}
    links = (replace(link, default_mass=0.0) if link.name in own else link for link in whole.links)
    return with_inertials(
        replace(whole, source=robot.source, links=tuple(links)), 'same', Report())


def with_inertials(robot: Robot, choice: str, report: Report) -> Robot:
    """
    Return a robot with an inertial for each link that has none, except the world.

    :param choice: a key of ``INERTIALS``; ``keep`` adds nothing and warns instead. ``same`` does
        so too, but beside links with mass it writes the mass that simulators give links of SDF.
        ``physical`` is ``same`` and corrects physically impossible inertials.
    :raises DescriptionError: see `with_physical_inertials`.
    """
    if choice == 'physical':
        robot = with_physical_inertials(robot, report)
    is_same = choice in _SIMULATED and any(link.inertial for link in robot.links)

    def filled(link: Link) -> Link:
        is_heavy = is_same and link.default_mass and not is_massless(link)
        values = DEFAULT_INERTIAL if is_heavy else INERTIALS[choice]
        if link.inertial or link.is_world or values is None:
            return link
        if is_heavy:
            report.preserve('link', link.name, link.line, 'has no <inertial>; written with the '
                            '1 kg that simulators give it in SDF')
        placement = Placement(Pose(), FrameId('link', link.name))
        return replace(link, inertial=Inertial(placement, *values))

    robot = replace(robot, links=tuple(map(filled, robot.links)))
    without = [link for link in robot.links if link.inertial is None and not link.is_world]
    if without:
        others = [link.name for link in without[1:]]
        like = f', like {shortened(others)}' if others else ''
        report.warn('link', without[0].name, without[0].line, (
            f'has no <inertial>{like}: massless in URDF, 1 kg in SDF; '
            'choose with --inertial zero or --inertial default'))
    return robot


def with_mesh_uris(robot: Robot, choice: str) -> Robot:
    """
    Return a robot with the URIs of meshes and textures in the scheme of a format.

    :param choice: ``package`` or ``model`` to replace the other of both schemes; ``keep`` to
        keep all URIs.
    """
    if choice == 'keep':
        return robot
    new = _SCHEMES[choice]
    old, = {*_SCHEMES.values()} - {new}

    def uri(value: str) -> str:
        return new + value.removeprefix(old) if value.startswith(old) else value

    def converted(shape: Shape) -> Shape:
        geometry, material = shape.geometry, shape.material
        if isinstance(geometry, Mesh):
            shape = replace(shape, geometry=replace(geometry, uri=uri(geometry.uri)))
        if material and material.texture:
            shape = replace(shape, material=replace(material, texture=uri(material.texture)))
        return shape

    return replace(robot, links=tuple(
        replace(link, visuals=tuple(map(converted, link.visuals)),
                collisions=tuple(map(converted, link.collisions))) for link in robot.links))
