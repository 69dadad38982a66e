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

"""Pictures a second of the page of robot_view while all joints move, drawn by the processor."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
import shutil
import sys
import tempfile

from figures import add_json_option, Figure, print_figures
from opencv_tools.robot.view.content import read_content, ViewOptions
from opencv_tools.robot.view.single_file import html_page
from opencv_tools.robot.xml.report import Report

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / 'test' / 'support'))
from chromium import BROWSER, new_browser  # noqa: E402, I100

LINKS = 100
RATE_GOAL = 60.0  # pictures a second of a screen
SECONDS = 5

_LINK = ('<link name="l{0}"><visual><geometry><box size="0.05 0.05 0.1"/></geometry></visual>'
         '</link>')
_JOINT = ('<joint name="j{0}" type="continuous"><parent link="l{1}"/><child link="l{0}"/>'
          '<origin xyz="0 0 0.1"/><axis xyz="0 1 0"/></joint>')
_MOVE = f"""(async () => {{
  const {{ joints }} = robotView.page.document.robots[0];
  const before = robotView.stage.draws;
  const start = performance.now();
  let busy = 0;
  while (performance.now() - start < {SECONDS * 1000}) {{
    const now = performance.now();
    const angle = Math.sin(now / 1000) / 50;
    const [view] = robotView.page.views;
    view.motion.place(joints.map((_, number) => [number, [angle]]));
    view.update();
    robotView.stage.draw();
    busy += performance.now() - now;
    await new Promise((done) => requestAnimationFrame(done));
  }}
  const draws = robotView.stage.draws - before;
  return [draws / (performance.now() - start) * 1000, busy / draws];
}})()"""


def measure(folder: Path) -> Iterator[Figure]:
    """Measure the page of a chain of links."""
    robot, page_file = folder / 'robot.urdf', folder / 'robot.html'
    links = ''.join(_LINK.format(number) for number in range(LINKS))
    joints = ''.join(_JOINT.format(number, number - 1) for number in range(1, LINKS))
    robot.write_text(f'<robot name="chain">{links}{joints}</robot>')
    page_file.write_bytes(b''.join(html_page(read_content(
        ViewOptions(paths=[str(robot)]), Report()))))
    with new_browser(options=('--enable-unsafe-swiftshader',)) as browser:
        page = browser.new_page(page_file.as_uri())
        page.wait_for('window.robotView?.stage?.draws > 0')
        rate, busy = page.evaluate(_MOVE)
    yield Figure('robot_page', f'pictures of {LINKS} links that move', rate, '1/s',
                 f'at least {RATE_GOAL:g} on an idle machine', rate >= RATE_GOAL * 0.95)
    yield Figure('robot_page', 'time of the script for a picture', busy, 'ms')


def main() -> int:
    """Print the figures; the exit status is 1 if a goal is not met."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_json_option(parser)
    options = parser.parse_args()
    if shutil.which(BROWSER) is None:
        print(f'{BROWSER} is missing: sudo apt install {BROWSER}')
        return 0
    with tempfile.TemporaryDirectory() as folder:
        figures = print_figures(measure(Path(folder)), options.json)
    return int(any(figure.met is False for figure in figures))


if __name__ == '__main__':
    sys.exit(main())
