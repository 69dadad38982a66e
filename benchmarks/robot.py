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

"""Time of urdf_to_sdf against libsdformat, and its growth with the robot."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
import random
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

from figures import add_json_option, Figure, write_figures
from opencv_tools.robot.convert import convert_to_sdf
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.xml.document import to_bytes
from opencv_tools.robot.xml.report import Report

LINKS = 100
CHAIN = 5000

RATIO_GOAL = 1.0
AIM = 0.5
IN_PROCESS_GOAL = 60.0  # ms
HELP_GOAL = 0.25  # s
CHAIN_GOAL = 5.0  # s
LINEAR_GOAL = 2.5  # twice the links may take this many times the time

COLORS = {'black': '0.1 0.1 0.1 1', 'orange': '0.9 0.45 0.05 1', 'steel': '0.62 0.64 0.66 1'}

LINK = """
  <link name="{name}">
    <inertial>
      <origin xyz="{n[0]} {n[1]} {n[2]}" rpy="0 0 0"/>
      <mass value="{mass}"/>
      <inertia ixx="{i[0]}" ixy="0.0" ixz="0.0" iyy="{i[1]}" iyz="0.0" izz="{i[2]}"/>
    </inertial>
    <visual name="{name}_shell">
      <origin xyz="{n[3]} {n[4]} {n[5]}" rpy="{n[6]} {n[7]} {n[8]}"/>
      <geometry>
        <mesh filename="package://bench_description/meshes/{name}.dae" scale="0.001 0.001 0.001"/>
      </geometry>
      <material name="{color}"/>
    </visual>
    <visual name="{name}_cover">
      <origin xyz="{n[9]} {n[10]} {n[11]}" rpy="0 0 1.5707963267948966"/>
      <geometry>
        <cylinder radius="{size[0]}" length="{size[1]}"/>
      </geometry>
      <material name="{name}_paint">
        <color rgba="{size[0]} {size[1]} {size[2]} 1"/>
      </material>
    </visual>
    <collision name="{name}_hull">
      <origin xyz="{n[3]} {n[4]} {n[5]}" rpy="{n[6]} {n[7]} {n[8]}"/>
      <geometry>
        <box size="{size[0]} {size[1]} {size[2]}"/>
      </geometry>
    </collision>
  </link>
"""
JOINT = """
  <joint name="{name}_joint" type="revolute">
    <origin xyz="{n[12]} {n[13]} {n[14]}" rpy="{n[15]} {n[16]} {n[17]}"/>
    <parent link="{parent}"/>
    <child link="{name}"/>
    <axis xyz="{axis}"/>
    <limit lower="{limit[0]}" upper="{limit[1]}" effort="{limit[2]}" velocity="{limit[3]}"/>
    <dynamics damping="0.05" friction="0.02"/>
    <safety_controller soft_lower_limit="{limit[0]}" soft_upper_limit="{limit[1]}"
      k_position="20" k_velocity="400"/>
  </joint>
  <transmission name="{name}_transmission">
    <type>transmission_interface/SimpleTransmission</type>
    <joint name="{name}_joint">
      <hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface>
    </joint>
    <actuator name="{name}_motor">
      <mechanicalReduction>100</mechanicalReduction>
    </actuator>
  </transmission>
"""


def legged(links: int) -> str:
    """Return the URDF of a robot with many limbs and realistic links."""
    generator = random.Random(7)
    parts = ['<?xml version="1.0"?>\n<robot name="bench">\n']
    parts += [f'  <material name="{name}">\n    <color rgba="{rgba}"/>\n  </material>\n'
              for name, rgba in COLORS.items()]
    for number in range(links):
        values = {
            'name': f'limb_{number // 10}_segment_{number % 10}',
            # Limbs of ten links, each on the first link.
            'parent': f'limb_{number // 10}_segment_{number % 10 - 1}' if number % 10
            else 'limb_0_segment_0',
            'n': [round(generator.uniform(-1, 1), 6) for _ in range(18)],
            'i': [round(generator.uniform(0.01, 0.02), 9) for _ in range(3)],
            'size': [round(generator.uniform(0.02, 0.4), 6) for _ in range(3)],
            'mass': round(generator.uniform(0.1, 4), 6),
            'limit': [-round(generator.uniform(1, 3), 6), round(generator.uniform(1, 3), 6),
                      round(generator.uniform(10, 200), 3), round(generator.uniform(1, 9), 3)],
            'axis': generator.choice(['1 0 0', '0 1 0', '0 0 1', '0 -1 0']),
            'color': generator.choice(list(COLORS)),
        }
        parts.append(LINK.format(**values))
        if number:
            parts.append(JOINT.format(**values))
    return ''.join([*parts, '</robot>\n'])


def chain(links: int) -> str:
    """Return the URDF of a chain of links."""
    inertial = ('<inertial><mass value="0.1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" '
                'iyz="0" izz="0.01"/></inertial>')
    parts = [f'<link name="link_{number}">{inertial}</link>\n' for number in range(links)]
    parts += [f'<joint name="joint_{number}" type="revolute"><origin xyz="0.1 0 0" rpy="0 0.1 0"/>'
              f'<parent link="link_{number - 1}"/><child link="link_{number}"/><axis xyz="0 0 1"/>'
              '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>\n'
              for number in range(1, links)]
    return f'<robot name="chain">\n{"".join(parts)}</robot>\n'


def seconds(command: Sequence[str]) -> float:
    """Return the time of a command in seconds; a failed command ends the benchmark."""
    began = time.perf_counter()
    finished = subprocess.run(command, capture_output=True, text=True, check=False)
    elapsed = time.perf_counter() - began
    if finished.returncode != 0 or 'Error' in finished.stderr.replace('Library error', ''):
        raise SystemExit(f'{" ".join(command)}: exit status {finished.returncode}\n'
                         f'{finished.stderr}')
    return elapsed


def medians(runs: int, *commands: Sequence[str]) -> list[float]:
    """Return the median time of each command in seconds, after one run of each."""
    for command in commands:
        seconds(command)
    times = [[seconds(command) for command in commands] for _ in range(runs)]
    return [statistics.median(column) for column in zip(*times)]


def in_process(path: Path, runs: int) -> tuple[float, float]:
    """Return median and minimum time of a conversion in ms, without the start of Python."""
    times = []
    for _ in range(runs + 1):
        began = time.perf_counter()
        report = Report()
        to_bytes(convert_to_sdf(read_robot(str(path), report)[0], report))
        times.append(time.perf_counter() - began)
    return 1e3 * statistics.median(times[1:]), 1e3 * min(times)


def measure(folder: Path, runs: int, log: Callable[[str], None]) -> list[Figure]:
    """Return all figures, and report each figure at once."""
    figures: list[Figure] = []

    def note(name: str, value: float, unit: str, goal: float, aim: str = '') -> None:
        figures.append(Figure('robot', name, value, unit, f'at most {goal:g}{aim}', value <= goal))
        verdict = 'met' if value <= goal else 'missed'
        log(f'{name}: {value:.3g} {unit} (goal: at most {goal:g}{aim}; {verdict})')

    command = shutil.which('urdf_to_sdf')
    if command is None:
        raise SystemExit('urdf_to_sdf is not in PATH; make bench finds it')
    robot, output = folder / 'robot.urdf', str(folder / 'robot.sdf')
    robot.write_text(legged(LINKS))
    size = robot.stat().st_size / 1000
    log(f'{LINKS} links, {size:.0f} kB, median of {runs} runs in turn')
    ours = [command, str(robot), '-o', output]
    if shutil.which('ign'):
        theirs = [shutil.which('ign') or 'ign', 'sdf', '-p', str(robot)]
        own, other = medians(runs, ours, theirs)
        log(f'urdf_to_sdf {1e3 * own:.0f} ms, ign sdf -p {1e3 * other:.0f} ms')
        note(f'urdf_to_sdf to ign sdf -p, {LINKS} links', own / other, 'x', RATIO_GOAL,
             f', aim {AIM:g}')
    else:
        log('ign is missing, so there is nothing to compare with: '
            'sudo apt install ignition-tools libsdformat-dev')
    median, least = in_process(robot, max(runs, 20))
    log(f'in process: {least:.0f} ms at least, {median:.0f} ms in the median')
    note(f'conversion in process, {LINKS} links', median, 'ms', IN_PROCESS_GOAL)
    note('urdf_to_sdf --help', medians(runs, [command, '--help'])[0], 's', HELP_GOAL)

    paths = [folder / f'chain_{links}.urdf' for links in (CHAIN, CHAIN // 2)]
    for path, links in zip(paths, (CHAIN, CHAIN // 2)):
        path.write_text(chain(links))
    long, short = medians(3, *([command, str(path), '-o', output] for path in paths))
    note(f'urdf_to_sdf, a chain of {CHAIN} links', long, 's', CHAIN_GOAL)
    note(f'a chain of {CHAIN} links to one of {CHAIN // 2}', long / short, 'x', LINEAR_GOAL)
    return figures


def main() -> int:
    """Print the figures and return the exit status, which is 1 if a goal was missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--runs', type=int, default=15, help='runs to take the median of')
    add_json_option(parser)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        figures = measure(Path(folder), options.runs, lambda text: print(text, flush=True))
    if options.json:
        write_figures(options.json, figures)
    return 0 if all(figure.met for figure in figures) else 1


if __name__ == '__main__':
    sys.exit(main())
