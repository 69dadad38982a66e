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

"""Calibrations for tests, as files and as hypothesis strategies."""

from __future__ import annotations

from hypothesis import HealthCheck, settings, strategies as st
from sensor_msgs.msg import CameraInfo, RegionOfInterest

#: Right camera of a stereo pair, as cameracalibrator of camera_calibration writes it.
CALIBRATION = """image_width: 640
image_height: 480
camera_name: 0123e4
camera_matrix:
  rows: 3
  cols: 3
  data: [602.31847,   0.     , 318.90521,
           0.     , 603.07712, 243.11608,
           0.     ,   0.     ,   1.     ]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.087120, -0.193355, 0.001127, -0.000805, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [ 0.99984103, -0.00411876,  0.0173492 ,
          0.00408522,  0.99998972,  0.00196837,
         -0.01735713, -0.00189718,  0.99984756]
projection_matrix:
  rows: 3
  cols: 4
  data: [588.41903,   0.     , 309.57274, -70.61028,
           0.     , 588.41903, 241.80466,   0.     ,
           0.     ,   0.     ,   1.     ,   0.     ]
"""
#: Keys that camera_calibration_parsers adds.
OPERATION = """binning_x: 2
binning_y: 1
roi:
  x_offset: 10
  y_offset: 21
  height: 100
  width: 33
  do_rectify: true
"""
SIZES = st.integers(1, 2**32 - 1)
#: Settings of hypothesis without time limits.
ANY_MACHINE = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
MODELS = st.from_regex(r'[A-Za-z0-9_]{0,64}', fullmatch=True)
NAMES = st.from_regex(r'[A-Za-z0-9_.-]{0,127}[A-Za-z0-9]', fullmatch=True)


@st.composite
def camera_infos(draw: st.DrawFn, numbers: st.SearchStrategy[float] = NUMBERS) -> CameraInfo:
    width, height = draw(SIZES), draw(SIZES)
    left, top = draw(st.integers(0, width)), draw(st.integers(0, height))
    roi = RegionOfInterest(
        x_offset=left, y_offset=top, width=draw(st.integers(0, width - left)),
        height=draw(st.integers(0, height - top)), do_rectify=draw(st.booleans()))
    k, r, p = (draw(st.lists(numbers, min_size=n, max_size=n)) for n in (9, 9, 12))
    return CameraInfo(
        width=width, height=height, distortion_model=draw(MODELS), d=draw(st.lists(numbers)),
        k=k, r=r, p=p, binning_x=draw(SIZES), binning_y=draw(SIZES), roi=roi)
