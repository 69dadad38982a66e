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

"""``robot_compare --all``: each change of one element is found, beside those of the model too."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import xml.etree.ElementTree as ET

from opencv_tools.robot.cli import robot_compare, sdf_to_urdf, urdf_to_sdf
from opencv_tools.robot.compare.compare import differences
from opencv_tools.robot.load import read_element
from opencv_tools.robot.model import Robot
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.xml.document import parse
from opencv_tools.robot.xml.report import Report
import pytest

SDF = """<sdf version="1.11"><model name="rover"><self_collide>true</self_collide>
<link name="base"><gravity>false</gravity><enable_wind>true</enable_wind>
<velocity_decay><linear>0.1</linear><angular>0.2</angular></velocity_decay>
<inertial><pose>0 0 0.1 0 0 0</pose><mass>2</mass><inertia><ixx>0.1</ixx><ixy>0.01</ixy>
<ixz>0.02</ixz><iyy>0.2</iyy><iyz>0.03</iyz><izz>0.25</izz></inertia></inertial>
<collision name="hull"><pose>0 0 0.1 0 0 0.5</pose>
<geometry><box><size>1 2 3</size></box></geometry>
<laser_retro>5</laser_retro><max_contacts>7</max_contacts><surface>
<bounce><restitution_coefficient>0.5</restitution_coefficient><threshold>2</threshold></bounce>
<friction><ode><mu>0.7</mu><mu2>0.8</mu2><fdir1>1 0 0</fdir1><slip1>0.1</slip1></ode>
<torsional><coefficient>0.3</coefficient></torsional></friction>
<contact><ode><kp>100000</kp><kd>10</kd><max_vel>0.1</max_vel><min_depth>0.001</min_depth></ode>
</contact></surface></collision>
<visual name="paint"><cast_shadows>false</cast_shadows><transparency>0.25</transparency>
<geometry><mesh><uri>model://rover/meshes/hull.dae</uri><scale>1 1 2</scale></mesh></geometry>
<material><diffuse>1 0 0 1</diffuse><ambient>0.5 0 0 1</ambient>
<script><uri>file://media/gazebo.material</uri><name>Gazebo/Wood</name></script>
<pbr><metal><albedo_map>wood.png</albedo_map><roughness>0.4</roughness><metalness>0.6</metalness>
</metal></pbr></material></visual>
<sensor name="eye" type="camera"><pose>0.1 0 0.2 0 0 0</pose><update_rate>30</update_rate>
<always_on>1</always_on><topic>eye</topic><camera><horizontal_fov>1.05</horizontal_fov>
<image><width>640</width><height>480</height><format>R8G8B8</format></image>
<clip><near>0.1</near><far>100</far></clip>
<noise><type>gaussian</type><stddev>0.007</stddev></noise></camera></sensor>
<light name="lamp" type="spot"><diffuse>1 1 0.5 1</diffuse><direction>0 0 -1</direction></light>
</link>
<link name="wheel"><pose>0 1 0 0 0 0</pose><inertial><mass>3</mass></inertial></link>
<joint name="axle" type="revolute"><parent>base</parent><child>wheel</child>
<axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>2</upper><effort>3</effort>
<velocity>4</velocity></limit><dynamics><damping>0.1</damping><friction>0.2</friction>
<spring_reference>0.3</spring_reference><spring_stiffness>0.4</spring_stiffness></dynamics></axis>
<physics><ode><limit><cfm>0.1</cfm><erp>0.3</erp></limit></ode></physics></joint>
<frame name="tip" attached_to="wheel"><pose>0 0 1 0 0 0</pose></frame>
<plugin name="drive" filename="libdrive.so"><odom_rate>50</odom_rate><topic>cmd_vel</topic>
</plugin>
</model></sdf>
"""
URDF = """<robot name="rover">
<link name="base"><inertial><origin xyz="0 0 0.1" rpy="0 0 0"/><mass value="2"/>
<inertia ixx="0.1" ixy="0.01" ixz="0.02" iyy="0.2" iyz="0.03" izz="0.25"/></inertial>
<visual><origin xyz="0 0 0.1"/><geometry><cylinder radius="0.5" length="1"/></geometry>
<material name="red"><color rgba="1 0 0 1"/></material></visual>
<collision><geometry><sphere radius="0.5"/></geometry></collision></link>
<link name="wheel"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="axle" type="revolute"><origin xyz="0 1 0" rpy="0 0 0.5"/><parent link="base"/>
<child link="wheel"/><axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="3" velocity="4"/>
<dynamics damping="0.1" friction="0.2"/><safety_controller k_velocity="10" k_position="15"/>
</joint>
<transmission name="gear"><type>transmission_interface/SimpleTransmission</type>
<joint name="axle"><hardwareInterface>EffortJointInterface</hardwareInterface></joint>
<actuator name="motor"><mechanicalReduction>50</mechanicalReduction></actuator></transmission>
<ros2_control name="hardware" type="system"><hardware>
<plugin>mock_components/GenericSystem</plugin>
</hardware><joint name="axle"><command_interface name="position"><param name="min">-1</param>
</command_interface></joint></ros2_control>
<gazebo reference="base"><mu1>0.7</mu1><mu2>0.8</mu2><kp>100000</kp><kd>10</kd>
<minDepth>0.001</minDepth><maxVel>0.1</maxVel><selfCollide>true</selfCollide>
<turnGravityOff>true</turnGravityOff><material>Gazebo/Orange</material>
<sensor name="ring" type="gpu_lidar"><update_rate>10</update_rate></sensor></gazebo>
<gazebo reference="axle"><implicitSpringDamper>true</implicitSpringDamper><stopCfm>0.1</stopCfm>
<provideFeedback>true</provideFeedback></gazebo>
<gazebo><plugin name="drive" filename="libdrive.so"><odom_rate>50</odom_rate></plugin></gazebo>
</robot>
"""
ROBOTS = {'sdf': SDF, 'urdf': URDF}
# A flag, or a word that the format defines, has this other value; the other texts get an end.
OTHER = {'true': 'false', 'false': 'true', 'revolute': 'prismatic', 'spot': 'point',
         'camera': 'depth_camera', 'gaussian': 'none', 'gpu_lidar': 'imu', 'base': 'wheel',
         'wheel': 'base',
         'R8G8B8': 'L8'}
# References and versions, whose change is another robot or an error.
KEPT = {'sdf@version', 'model@name', 'link@name', 'joint@name', 'joint/parent', 'joint/child',
        'parent@link', 'child@link', 'gazebo@reference', 'material@name'}


def other(text: str) -> str:
    """Return another valid value for a text."""
    first, *rest = text.split()
    try:
        return ' '.join([str(float(first) * 1.25 + 0.125), *rest])
    except ValueError:
        return OTHER.get(text, f'{text}x')


def changed(source: str) -> Iterator[tuple[str, str]]:
    """Return robots in which one attribute, text or element of a robot differs."""
    tree = ET.fromstring(source)
    for parent in tree.iter():
        for child in list(parent):
            place = f'{parent.tag}/{child.tag}'
            for name, value in child.attrib.items():
                if f'{child.tag}@{name}' not in KEPT:
                    child.set(name, other(value))
                    yield f'{place}@{name}', ET.tostring(tree, encoding='unicode')
                    child.set(name, value)
            text = (child.text or '').strip()
            if text and place not in KEPT:
                child.text = other(text)
                yield place, ET.tostring(tree, encoding='unicode')
                child.text = text
                if place == 'mesh/uri':
                    continue  # a mesh must have it
                index = list(parent).index(child)
                parent.remove(child)
                yield f'no {place}', ET.tostring(tree, encoding='unicode')
                parent.insert(index, child)


def robot_of(text: str) -> Robot:
    """Read a robot."""
    return read_element(parse(text.encode(), 'robot', Report()), Report())[0]


@pytest.fixture(params=ROBOTS)
def original(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Write a robot."""
    path = tmp_path / f'robot.{request.param}'
    path.write_text(ROBOTS[request.param])
    return path


@pytest.mark.parametrize('kind', ROBOTS)
def test_single_change_is_found(kind: str) -> None:
    original, changes = robot_of(ROBOTS[kind]), list(changed(ROBOTS[kind]))
    assert len(changes) > 70
    missed = [f'{number} {place}' for number, (place, text) in enumerate(changes)
              if not differences(original, robot_of(text), samples=1, everything=True)]
    assert missed == []


def test_text_with_digits_is_no_number(tmp_path: Path) -> None:
    paths = [tmp_path / f'{number}.urdf' for number in range(2)]
    for path, text in zip(paths, ('1_0', '10')):
        path.write_text(URDF.replace('<odom_rate>50<', f'<odom_rate>{text}<'))
    assert robot_compare([*map(str, paths), '--all']) == 1


def test_same_elements_in_another_way(original: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = original.read_text()
    same = original.with_name(f'same{original.suffix}')
    for old, new in (('0.7<', '7e-1 <'), ('>true<', '> 1 <'), ('100000', '1.0E5')):
        assert old in source
        source = source.replace(old, new)
    same.write_text(source)
    assert robot_compare([str(original), str(same), '--all']) == 0, capsys.readouterr().out


def test_there_and_back(original: Path, capsys: pytest.CaptureFixture[str]) -> None:
    there, back = original.with_name('there.xml'), original.with_name(f'back{original.suffix}')
    ways = [urdf_to_sdf, sdf_to_urdf]
    for way, source, target in zip(ways if original.suffix == '.urdf' else ways[::-1],
                                   (original, there), (there, back)):
        assert way([str(source), '-o', str(target)]) == 0
    for other_file in (there, back):
        assert robot_compare([str(original), str(other_file), '--all']) == 0, (
            capsys.readouterr().out)


def test_surfaces_and_materials_of_gazebo_without_all() -> None:
    def robot(block: str) -> Robot:
        text = ('<robot name="r"><link name="a"><visual><geometry><sphere radius="1"/></geometry>'
                '</visual><collision><geometry><sphere radius="1"/></geometry></collision></link>'
                f'<gazebo reference="a">{block}</gazebo></robot>')
        return read_urdf(parse(text.encode(), 'r.urdf', Report()), Report())

    plain = robot('')
    for block, what in (('<mu1>0.375</mu1>', ('collision', 'surface/friction/ode/mu')),
                        ('<material>Gazebo/Wood</material>', ('visual', 'material/script/name')),
                        ('<material>Gazebo/Gold</material>', ('visual', 'color'))):
        found, *_ = differences(plain, robot(block))
        assert (found.element, found.property) == what
    assert differences(plain, robot('<turnGravityOff>1</turnGravityOff>')) == []
