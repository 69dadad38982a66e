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

"""Facts of a whole URDF file that its elements are read with, and its ``<gazebo>`` blocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from lxml import etree
from opencv_tools.robot.geometry import Color
from opencv_tools.robot.model import Extension, FrameId, MODEL
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.fragments import fragment_flaw
from opencv_tools.robot.sdf.values import (
    colors_of, GAZEBO, MODEL_PARTS, POSED, PRESERVING_TAGS)
from opencv_tools.robot.urdf.materials import collect_materials, MaterialTable
from opencv_tools.robot.urdf.poses import in_link_frame, preserved_pose
from opencv_tools.robot.urdf.settings import set_value, Setting, SETTING_OF, SETTING_TAGS
from opencv_tools.robot.urdf.tree import build_tree, LinkTree
from opencv_tools.robot.xml.document import (
    detached, Element, line_of, local_name, PARTLY_READ, required_name, TrackedElement)
from opencv_tools.robot.xml.passthrough import extract_foreign, merge_unread, SDF_TAG
from opencv_tools.robot.xml.report import Report

# Elements that an owner may have several times.
_SEVERAL = POSED.union(MODEL_PARTS, ('audio_sink', 'battery', 'gripper', 'plugin'))
_FLAGS = {'yes': 'true', 'no': 'false'}  # words that only ``<gazebo>`` allows
# Elements of a link or joint whose contents Gazebo adds to all visuals or collisions of the link,
# or to the physics of the joint.
_MERGED = {('link', 'visual'): 'visual', ('link', 'collision'): 'collision',
           ('joint', 'physics'): 'joint'}
# Children of ``<visual>`` and ``<collision>`` of which the last one counts, or none.
_REPLACED, _FIXED = ('material', 'surface'), ('geometry', 'pose')


@dataclass(frozen=True)
class Extracted:
    """
    The SDF of the ``<gazebo>`` blocks.

    :param moved: elements that SDF has in the model, link or joint, by that.
    :param values: values of settings, by `settings.Setting.owner` and a name.
    :param colors: colours of all visuals, by link.
    :param remaining: the blocks with what remains in them.
    """

    moved: dict[FrameId, list[Element]] = field(default_factory=dict)
    values: dict[tuple[str, str], Element] = field(default_factory=dict)
    colors: dict[str, dict[str, Color]] = field(default_factory=dict)
    remaining: list[Element] = field(default_factory=list)

    def with_settings(self, extension: Extension, owner: str, name: str) -> Extension:
        """Return an extension with the settings of a link or joint, or of its shapes."""
        values = self.values.get((owner, name))
        if values is None:
            return extension
        sdf = etree.Element(owner) if extension.sdf is None else detached(extension.sdf)
        merge_unread(sdf, values, marked=True, in_front=True)
        return extension.with_sdf(sdf)


def extract_sdf(root: TrackedElement, tree: LinkTree, report: Report) -> Extracted:
    """Extract the elements of SDF and the settings from the ``<gazebo>`` blocks."""
    extracted = Extracted()
    for block in root.take_all('gazebo'):
        name = block.get('reference')
        owners = [MODEL] if name is None else [
            FrameId(kind, name) for kind, names in (('link', tree.links), ('joint', tree.joints))
            if name in names]
        if not owners:
            report.warn('gazebo', name or '', line_of(block), f'reference={name!r} is not a link '
                        'or joint of the robot; the element is preserved unchanged')
        copy = detached(block.element)
        copy.text = None
        # libsdformat writes damping once for each block, and reads the first one.
        is_damped = any(child.tag == 'velocity_decay' for owner in owners for child in (
            *extracted.moved.get(owner, ()), *extracted.values.get(owner, ())))
        # Settings replace the values of <visual>, <collision> and <physics> in their block.
        for element in sorted(copy.iterchildren('*'), key=lambda one: one.tag in SETTING_TAGS):
            flaw = 'has no effect: an earlier <gazebo> of the link has damping' if (
                is_damped and element.tag == 'dampingFactor') else _extract(
                    element, owners, root.get('name', ''), tree, extracted, report)
            if flaw is None:
                copy.remove(element)
            elif flaw:
                report.warn(local_name(element), name or '', line_of(element),
                            f'{flaw}; the element is preserved unchanged')
        if len(copy) or set(copy.attrib) - {'reference'} or not owners:
            extracted.remaining.append(copy)
    for key in [key for key in extracted.values if key[0] == 'visual']:
        visual = TrackedElement(extracted.values.pop(key))
        if (material := visual.find('material')) is not None:
            extracted.colors[key[1]] = colors_of(material)
        if (rest := visual.unread()) is not None:
            extracted.values[key] = rest
    return extracted


def _extract(element: Element, owners: Sequence[FrameId], robot: str, tree: LinkTree,
             extracted: Extracted, report: Report) -> str | None:
    """
    Read an element of a block as a setting, or as an element that SDF has in the owner.

    :param robot: name of the robot, for the report.
    :returns: why the element stays in its block, empty if it belongs there; None if it does not.
    """
    tag = str(element.tag)
    text = (element.get('value') or element.text or '').strip()
    text = _FLAGS.get(text.lower(), text)
    for owner in owners:
        if holder := _MERGED.get((owner.kind, tag)):
            if holder != 'joint' and not _has_shapes(holder, owner.name, tree):
                return ''  # it has no effect in Gazebo either
            flaw = fragment_flaw(element, is_exact=True)
            if not flaw:
                values = extracted.values.setdefault((holder, owner.name), etree.Element(holder))
                _add_parts(values, element, owner.name, report)
                report.preserve(tag, owner.name, line_of(element),
                                f'moved from <gazebo> into each {tag} of the {owner.kind}')
            return flaw or None
        if tag in GAZEBO[owner.kind] or (owner == MODEL and tag in MODEL_PARTS):
            copy = detached(element)
            copy.text = text if text in ('true', 'false') else copy.text
            flaw = fragment_flaw(copy)
            if not flaw:
                held = extracted.moved.setdefault(owner, [])
                if tag not in _SEVERAL and any(one.tag == tag for one in held):
                    report.warn(tag, owner.name or robot, line_of(element),
                                'has no effect: an earlier one counts')
                held.append(copy)
                report.preserve(tag, owner.name or robot, line_of(element),
                                f'moved from <gazebo> into the {owner.kind}')
            return flaw or None
        if setting := SETTING_OF.get((owner.kind, tag)):
            if not _has_place(setting, owner.name, tree):
                return ''  # it has no effect in Gazebo either
            text = setting.converted(text)
            flaw = setting.flaw(text)
            if not flaw:
                key = setting.owner, owner.name
                values = extracted.values.setdefault(key, etree.Element(key[0]))
                if set_value(values, setting, text):
                    report.warn(tag, owner.name, line_of(element),
                                f'{text!r} replaces another value of an earlier <{tag}>')
            return flaw or None
    is_known = not owners or tag in PRESERVING_TAGS or tag.startswith('{')
    return '' if is_known else _loss(tag, owners[0], tree)


def _loss(tag: str, owner: FrameId, tree: LinkTree) -> str:
    is_moved = tag == 'pose' and owner.kind == 'link' and owner.name not in tree.parent_joint
    return 'moves the link in Gazebo, and is not converted' if is_moved else 'has no effect in SDF'


def _has_place(setting: Setting, name: str, tree: LinkTree) -> bool:
    """Return whether a link or joint has the element that a setting is about."""
    if setting.owner in _MERGED.values() and setting.owner != 'joint':
        return _has_shapes(setting.owner, name, tree)
    return setting.fits(tree.joints[name].element.get('type', '') if (
        setting.owner == 'joint') else '')


def _has_shapes(tag: str, name: str, tree: LinkTree) -> bool:
    """Return whether a link has visuals or collisions."""
    return any(tree.links[name].element.find(prefix + tag) is not None for prefix in ('', SDF_TAG))


def _add_parts(values: Element, element: Element, name: str, report: Report) -> None:
    """Add the contents of an element of a block to values, as libsdformat does."""
    copy = detached(element)
    for child in copy.findall('*') if copy.tag == values.tag else [copy]:
        for inner in child.iter(etree.Element):
            if len(inner):
                inner.set(PARTLY_READ, 'true')
        tag = str(child.tag)
        if tag in _FIXED:
            report.warn(tag, name, line_of(child), 'is omitted: it has no effect in Gazebo, '
                        f'because the <{copy.tag!s}> has its own')
            continue
        if tag in _REPLACED and (former := values.find(tag)) is not None:
            values.remove(former)
            report.warn(tag, name, line_of(child), 'replaces all of an earlier one')
        values.append(child)


@dataclass(frozen=True, kw_only=True)
class UrdfContext:
    """
    Facts of the whole file.

    :param version: version of URDF, such as ``1.0``.
    :param offsets: by link, the pose of its parent joint in it; without identities.
    """

    version: str
    report: Report
    tree: LinkTree
    materials: MaterialTable
    gazebo: Extracted
    offsets: Mapping[str, Pose]

    def link_frame(self, link: str) -> FrameId:
        """Return the frame of a link in URDF, which is that of its parent joint."""
        parent_joint = self.tree.parent_joint.get(link)
        if parent_joint is not None and link in self.offsets:
            return FrameId('joint', required_name(parent_joint))
        return FrameId('link', link)

    def extension(self, element: TrackedElement, owner: FrameId) -> Extension:
        """Return the XML of a link or joint that the model does not represent."""
        offset = self.offsets.get(owner.name) if owner.kind == 'link' else None
        moved = [in_link_frame(child, offset) for child in self.gazebo.moved.get(owner, [])]
        return self.gazebo.with_settings(_extension(element, moved), owner.kind, owner.name)

    def robot_extension(self, root: TrackedElement) -> Extension:
        """Return the XML of the robot that the model does not represent."""
        extension = _extension(root, self.gazebo.moved.get(MODEL, []), self.gazebo.remaining)
        return self.gazebo.with_settings(extension, *MODEL)


def read_context(root: TrackedElement, report: Report, version: str) -> UrdfContext:
    """
    Read the tree, the materials and the ``<gazebo>`` blocks of a file, before its elements.

    :raises DescriptionError: the links and joints are not a tree, or a material is not valid.
    """
    tree = build_tree(root, report)
    gazebo = extract_sdf(root, tree, report)
    return UrdfContext(
        version=version, report=report, tree=tree, gazebo=gazebo,
        materials=collect_materials(root, report),
        offsets={link: pose for link, joint in tree.parent_joint.items()
                 if (pose := preserved_pose(joint)) is not None and not pose.is_identity})


def _extension(element: TrackedElement, sdf: Sequence[Element], urdf: Sequence[Element] = ()
               ) -> Extension:
    """Return the XML of an element that the model does not represent, with additional children."""
    preserved, tag = extract_foreign(element, 'sdf'), local_name(element)
    return Extension(_extended(element.unread(), tag, urdf), _extended(preserved, tag, sdf))


def _extended(unread: Element | None, tag: str, children: Sequence[Element]) -> Element | None:
    if children:
        unread = etree.Element(tag) if unread is None else unread
        unread.extend(children)
    return unread
