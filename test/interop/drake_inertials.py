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

"""
Print the inertials of SDF files as Drake computes them: python drake_inertials.py FILE...

The result is a JSON object of files, each with mass, centre of mass in the link, and moments of
inertia about the centre in the axes of the link, by link. Drake is on PyPI.
"""

from __future__ import annotations

import json
import sys

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant


def inertials(path: str) -> dict[str, list[float]]:
    """Return mass, centre and moments ixx, ixy, ixz, iyy, iyz, izz by link."""
    plant = MultibodyPlant(0.0)
    model, = Parser(plant).AddModels(path)
    found = {}
    for index in plant.GetBodyIndices(model):
        body = plant.get_body(index)
        inertia = body.default_spatial_inertia()
        centre, mass = inertia.get_com(), inertia.get_mass()
        # A shift needs no axes: the frame of the body is that of the link.
        moments = mass * inertia.Shift(centre).get_unit_inertia().CopyToFullMatrix3()
        found[body.name()] = [mass, *centre, *moments[0], *moments[1, 1:], moments[2, 2]]
    return found


if __name__ == '__main__':
    print(json.dumps({path: inertials(path) for path in sys.argv[1:]}))
