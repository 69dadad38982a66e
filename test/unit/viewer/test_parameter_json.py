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

"""Parameters of other nodes as JSON, and back."""

from __future__ import annotations

import json
from typing import Any

from opencv_tools.nodes.parameters import Parameter
from opencv_tools.viewer.control import parameter_json, value_from_json
from opencv_tools.viewer.errors import RequestError
import pytest
from rcl_interfaces.msg import ParameterDescriptor, ParameterValue
import rclpy.parameter


def message(value: Any) -> ParameterValue:
    return rclpy.parameter.Parameter('a', value=value).to_parameter_msg().value


def described(parameter: Parameter) -> dict[str, Any]:
    found = parameter_json(parameter.descriptor(), message(parameter.default))
    assert found is not None
    return json.loads(json.dumps(found))


def test_ranges() -> None:
    found = described(Parameter('gain', 5, 'Gain', bounds=(0, 100), step=5, changeable=True))
    assert found == {
        'name': 'gain', 'type': 'integer', 'value': 5, 'minimum': 0, 'maximum': 100, 'step': 5,
        'choices': [], 'description': 'Gain', 'read_only': False}
    found = described(Parameter('rate', 5.0, 'Rate', bounds=(0, 10)))
    assert (found['type'], found['minimum'], found['maximum'], found['step']) == (
        'double', 0, 10, None)
    assert found['read_only']


def test_menu_of_a_camera_control() -> None:
    found = described(Parameter(
        'power', 1, 'Camera control; the default is 1: 0 Disabled, 1 50 Hz, 2 60 Hz',
        choices=(0, 1, 2)))
    assert found['choices'] == [[0, 'Disabled'], [1, '50 Hz'], [2, '60 Hz']]


def test_choices_of_texts_and_switches() -> None:
    found = described(Parameter('flip', 'none', 'Mirroring', choices=('none', 'both')))
    assert found['choices'] == [['none', 'none'], ['both', 'both']]
    assert described(Parameter('on', True, 'Switch'))['type'] == 'bool'


def test_text_of_other_nodes_is_printable_and_bounded() -> None:
    descriptor = ParameterDescriptor(
        name='a\nb', description='\x1b[31m' + 'x' * 10_000,
        additional_constraints='one of: ' + '9' * 10_000)
    found = parameter_json(descriptor, message(5))
    assert found is not None
    assert found['name'] == r'a\nb'
    assert len(json.dumps(found)) < 3000
    assert '\x1b' not in found['description']


def test_lists_and_unset_parameters_are_left_out() -> None:
    for value in (ParameterValue(), message([1, 2]), message([b'a'])):
        assert parameter_json(ParameterDescriptor(name='a'), value) is None


def test_numbers_that_json_lacks_become_null() -> None:
    found = parameter_json(ParameterDescriptor(name='a'), message(float('nan')))
    assert found is not None
    assert found['value'] is None


@pytest.mark.parametrize(('present', 'given'), [
    (5, 6), (5.0, 6.5), (5.0, 6), (True, False), ('a', 'b'), ('a', '')])
def test_values_get_the_type_of_the_parameter(present: Any, given: Any) -> None:
    value = value_from_json(given, message(present))
    assert rclpy.parameter.parameter_value_to_python(value) == given
    assert value.type == message(present).type


@pytest.mark.parametrize(('present', 'given'), [
    (5, 6.5), (5, True), (5, '6'), (5, 2**63), (5, None), (5.0, '6'), (5.0, 2**2000), (True, 1),
    ('a', 5), ('a', None), ([1], [2])])
def test_values_of_another_type_are_refused(present: Any, given: Any) -> None:
    with pytest.raises(RequestError) as caught:
        value_from_json(given, message(present))
    assert len(str(caught.value)) < 200
