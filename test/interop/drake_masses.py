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
Print the total mass and mass matrices of robots as Drake reads them, as JSON by path.

A matrix is given for each of some positions, by pairs of joints.
"""

from __future__ import annotations

import json
from random import Random
import sys

from pydrake.all import MultibodyPlant, Parser


def masses(path: str) -> dict[str, object]:
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(path)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    moving = sorted((joint for joint in joints if joint.num_velocities() == 1),
                    key=lambda joint: str(joint.name()))
    matrices = []
    for seed in range(3):
        random = Random(seed)
        for joint in moving:
            plant.SetPositions(context, [
                random.uniform(-1, 1) if number == joint.position_start() else value
                for number, value in enumerate(plant.GetPositions(context))])
        matrix = plant.CalcMassMatrix(context)
        matrices.append({f'{a.name()} {b.name()}': matrix[a.velocity_start(), b.velocity_start()]
                         for a in moving for b in moving})
    return {'mass': plant.CalcTotalMass(context), 'matrices': matrices}


found = {}
for file in sys.argv[1:]:
    try:
        found[file] = masses(file)
    except RuntimeError as err:
        found[file] = {'error': str(err)}
print(json.dumps(found))
