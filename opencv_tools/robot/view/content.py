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

"""Content of the page: one or two robots, what differs between both, and their meshes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
import json

from opencv_tools.robot.compare.compare import Difference, differences, ordered_shapes
from opencv_tools.robot.compare.side import Key, shapes_of, Side
from opencv_tools.robot.load import LoadOptions
from opencv_tools.robot.model import Robot
from opencv_tools.robot.view.conventions import read_both
from opencv_tools.robot.view.document import Document, robot_document
from opencv_tools.robot.view.mesh_files import MeshFiles
from opencv_tools.robot.xml.report import Report

MAX_DIFFERENCES = 2000
_LARGE = 500  # links from which a robot is compared at fewer positions
_SAMPLES, _SAMPLES_OF_LARGE = 20, 2


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """
    Options of the page.

    :param paths: one robot file, or two that are compared.
    :param meshes: whether meshes are shown.
    """

    paths: Sequence[str]
    load: LoadOptions = field(default_factory=LoadOptions)
    meshes: bool = True


@dataclass(frozen=True)
class Content:
    """
    Content of the page.

    :param document: a value for `json.dumps`, see `read_content`.
    :param meshes: files of the meshes in the order of ``document['meshes']``.
    """

    document: Document
    meshes: MeshFiles


def read_content(options: ViewOptions, report: Report) -> Content:
    """
    Read the robots of the page.

    :returns: a document with ``robots``, see `document.robot_document` and
        `conventions.read_both`; the first ``differences`` of two robots and their number;
        ``meshes``, the files of `MeshFile` without their paths; and ``warnings``.
    :raises DescriptionError: a file is not a valid robot description, or is too large.
    """
    meshes, robots, documents = MeshFiles(options.meshes), [], []
    for path in options.paths:
        robot, files = read_both(path, report, options.load)
        meshes.search(robot.source, options.load.search)
        documents.append({**robot_document(robot, meshes), 'files': files})
        robots.append(robot)
    found = _differences(robots[0], robots[1]) if len(robots) > 1 else []
    return Content(page_document(documents, found, meshes, report), meshes)


def page_document(documents: Sequence[Document], found: Sequence[Document], meshes: MeshFiles,
                  report: Report) -> Document:
    """Return the document of `read_content`, given those of the robots and the differences."""
    return {
        'robots': documents,
        'differences': found[:MAX_DIFFERENCES], 'difference_count': len(found),
        'meshes': [{name: value for name, value in vars(one).items() if name != 'path'}
                   for one in meshes.files],
        'warnings': [note.text() for note in report.warnings][:MAX_DIFFERENCES],
    }


def to_json(document: Mapping[str, object]) -> str:
    """Return a document as text that is JSON, and that may be inside of an element of HTML."""
    text = json.dumps(document, separators=(',', ':'), allow_nan=False)
    return text.replace('<', '\\u003c').replace('>', '\\u003e').replace('&', '\\u0026')


def _differences(a: Robot, b: Robot) -> list[Document]:
    """
    Return what `compare.differences` finds, with the parts of the robots where it is shown.

    :returns: ``element``, ``name``, ``property``, ``a`` and ``b``; and for each robot ``parts``:
        a link, joint, visual or collision with the number of the link or joint and the number of
        the shape in the link; -1 if the robot lacks it.
    """
    large = max(len(a.links), len(b.links)) > _LARGE
    found = differences(a, b, samples=_SAMPLES_OF_LARGE if large else _SAMPLES)
    sides = Side(a), Side(b)
    ordered = ordered_shapes(*sides)
    places = [_places(side, ordered) for side in sides]
    return [{'element': one.element, 'name': one.name, 'property': one.property,
             'a': one.a, 'b': one.b, 'parts': [_place(one, place) for place in places]}
            for one in found]


def _place(difference: Difference, places: Mapping[Key, tuple[int, int]]
           ) -> tuple[int, int]:
    element = 'link' if difference.element == 'inertial' else difference.element
    return places.get((element, difference.name), (-1, -1))


def _places(side: Side, ordered: Collection[Key]) -> dict[Key, tuple[int, int]]:
    """Return the numbers of links, joints and shapes by the names of the comparison."""
    places = {('joint', name): (number, -1) for number, name in enumerate(side.joints)}
    for number, (key, link) in enumerate(side.links.items()):
        places['link', key] = number, -1
        for element, shapes in shapes_of(link):
            for index, shape in enumerate(shapes):
                name = index if (element, key) in ordered else shape.name
                places[element, f'{key}/{name}'] = number, index
    return places
