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

"""Start a publisher and, if wanted, a recorder and a viewer, with the parameters of a file."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from opencv_tools.nodes.command_line import check_params_file, has_section


EXECUTABLES = {'image_publisher': 'img_publisher', 'image_subscriber': 'img_subscriber',
               'image_viewer': 'img_viewer'}
#: Arguments that start a node, with default and description.
SWITCHES = {
    'image_subscriber': ('record', 'true', 'Whether to record the images to files'),
    'image_viewer': ('viewer', 'false', 'Whether to show the images in a browser'),
}
#: Arguments that are parameters of a node, with type and description.
PARAMETERS = {
    'image_publisher': {
        'source': (str, 'Camera number, file, folder, URL or pattern'),
        'width': (int, 'Width of the camera images in pixels'),
        'height': (int, 'Height of the camera images in pixels'),
        'publish_rate': (float, 'Rate in Hz, at least 0.1; 0.0 for the rate of the source'),
    },
    'image_subscriber': {'output_dir': (str, 'Folder of the recorded files')},
    'image_viewer': {},
}


def start_nodes(context: LaunchContext) -> list[Node]:
    """
    Create the nodes with the parameters of the file, overridden by launch arguments.

    :raises ParameterError: the parameter file does not exist.
    """
    params_file = LaunchConfiguration('params_file').perform(context)
    check_params_file(params_file)
    # A node refuses a file that is only for other nodes. If it is for none, all nodes report it.
    readers = [name for name, executable in EXECUTABLES.items()
               if has_section(params_file, {name, executable})] or list(EXECUTABLES)
    return [
        Node(package='opencv_tools', executable=executable, name=name, output='screen',
             namespace=LaunchConfiguration('namespace'),
             parameters=[*([params_file] if name in readers else []),
                         *given_parameters(context, name)])
        for name, executable in EXECUTABLES.items()
        if name not in SWITCHES
        or LaunchConfiguration(SWITCHES[name][0]).perform(context) == 'true']


def given_parameters(context: LaunchContext, name: str) -> list[dict[str, ParameterValue]]:
    """Return the parameters of a node that are given as launch arguments, if any."""
    given = {argument: ParameterValue(LaunchConfiguration(argument), value_type=value_type)
             for argument, (value_type, _) in PARAMETERS[name].items()
             if LaunchConfiguration(argument).perform(context)}
    return [given] if given else []


def generate_launch_description() -> LaunchDescription:
    """Return the launch description: arguments and nodes."""
    config = Path(get_package_share_directory('opencv_tools'), 'config', 'camera.yaml')
    return LaunchDescription([
        *(DeclareLaunchArgument(argument, default_value='', description=description)
          for parameters in PARAMETERS.values()
          for argument, (_, description) in parameters.items()),
        *(DeclareLaunchArgument(switch, default_value=default, choices=['false', 'true'],
                                description=description)
          for switch, default, description in SWITCHES.values()),
        DeclareLaunchArgument('namespace', default_value='',
                              description='Namespace of the nodes and their topics'),
        DeclareLaunchArgument('params_file', default_value=str(config),
                              description='YAML file with the parameters of the nodes'),
        OpaqueFunction(function=start_nodes),
    ])
