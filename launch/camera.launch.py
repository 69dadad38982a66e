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

"""Start a publisher, a subscriber and, if wanted, a viewer with the parameters of a file."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from opencv_tools.ros.command_line import check_params_file


ARGUMENTS = {
    'image_publisher': {'source': 'Camera number, file, folder, URL or pattern'},
    'image_subscriber': {'output_dir': 'Folder of the recorded files'},
    'image_viewer': {},
}
EXECUTABLES = {'image_publisher': 'img_publisher', 'image_subscriber': 'img_subscriber',
               'image_viewer': 'img_viewer'}


def start_nodes(context: LaunchContext) -> list[Node]:
    """
    Create the nodes with the parameters of the file, overridden by launch arguments.

    :raises ParameterError: the parameter file does not exist.
    """
    params_file = LaunchConfiguration('params_file').perform(context)
    check_params_file(params_file)
    nodes = []
    for name, executable in EXECUTABLES.items():
        if name == 'image_viewer' and LaunchConfiguration('viewer').perform(context) == 'false':
            continue
        values = {argument: LaunchConfiguration(argument).perform(context)
                  for argument in ARGUMENTS[name]}
        overrides = {argument: ParameterValue(value, value_type=str)
                     for argument, value in values.items() if value}
        nodes.append(Node(
            package='opencv_tools', executable=executable, name=name, output='screen',
            namespace=LaunchConfiguration('namespace'),
            parameters=[params_file, *([overrides] if overrides else [])]))
    return nodes


def generate_launch_description() -> LaunchDescription:
    """Return the launch description: arguments and nodes."""
    config = Path(get_package_share_directory('opencv_tools'), 'config', 'camera.yaml')
    arguments = [
        DeclareLaunchArgument(argument, default_value='', description=description)
        for described in ARGUMENTS.values() for argument, description in described.items()]
    return LaunchDescription([
        *arguments,
        DeclareLaunchArgument('viewer', default_value='false', choices=['false', 'true'],
                              description='Whether to show the images in a browser'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='Namespace of the nodes and their topics'),
        DeclareLaunchArgument('params_file', default_value=str(config),
                              description='YAML file with the parameters of the nodes'),
        OpaqueFunction(function=start_nodes),
    ])
