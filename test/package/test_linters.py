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

"""Linters of ROS 2 Jazzy, ruff, mypy, and the types of the pages."""

from __future__ import annotations

import hashlib
from importlib.metadata import distributions
import json
from pathlib import Path
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

from catkin_pkg.package import parse_package
from npm import installed
import pytest
from waiting import LONGEST_SECONDS

ROOT = Path(__file__).parents[2]
# What package.xml may depend on. Each key was looked up in ros/rosdistro of 2026-08-22 and has an
# apt package on Ubuntu 24.04: the first in jazzy/distribution.yaml, the others in rosdep/base.yaml
# and rosdep/python.yaml. Before a key is added here: rosdep resolve KEY --os ubuntu:noble
# --rosdistro jazzy. There is none for PyAV.
RELEASED = {
    'ament_copyright', 'ament_flake8', 'ament_index_python', 'ament_pep257', 'ament_xmllint',
    'builtin_interfaces', 'diagnostic_msgs', 'launch', 'launch_ros', 'rcl_interfaces', 'rclpy',
    'rosgraph_msgs', 'rosidl_adapter', 'sensor_msgs', 'std_msgs', 'std_srvs', 'stereo_msgs',
    'type_description_interfaces', 'xacro'}
SYSTEM_KEYS = {
    'python3-catkin-pkg-modules', 'python3-hypothesis', 'python3-lxml', 'python3-matplotlib',
    'python3-mypy', 'python3-numpy', 'python3-opencv', 'python3-pytest', 'python3-pytest-xdist',
    'python3-tornado', 'python3-tqdm', 'python3-yaml'}
CODE = ('opencv_tools', 'test', 'launch', 'examples', 'benchmarks', 'docs', 'setup.py')


def check(*command: str) -> None:
    """Run a checker from the root of the package; it has to find nothing."""
    finished = subprocess.run(command, cwd=ROOT, capture_output=True, text=True,
                              timeout=LONGEST_SECONDS,
                              check=False)
    if finished.returncode:
        pytest.fail(findings(finished.stdout + finished.stderr), pytrace=False)


def findings(output: str) -> str:
    """Return the output of a checker without the lines that only name a file that was read."""
    names = re.compile(r'(\* |checking |Checked files:|\s*$)')
    return '\n'.join(line for line in output.splitlines() if not names.match(line))


def flake8_hashes() -> dict[str, str]:
    """Return a hash of each file and of all that its check depends on."""
    files = [path for name in CODE for path in ([ROOT / name] if name.endswith('.py') else
                                                sorted((ROOT / name).rglob('*.py')))]
    checkers = sorted(f'{one.metadata["Name"]} {one.version}' for one in distributions())
    known = hashlib.sha256('\n'.join([
        sys.version, *checkers, Path(__file__).read_text()]).encode())

    def digest(path: Path) -> str:
        found = known.copy()
        found.update(path.read_bytes())
        return found.hexdigest()

    return {str(path.relative_to(ROOT)): digest(path) for path in files}


def tool(name: str, remedy: str) -> str:
    """Find a checker that only some machines can have."""
    path = shutil.which(name)
    if path is None:
        pytest.skip(f'{name} is not on this machine; {remedy}')
    return path


@pytest.mark.process
@pytest.mark.linter
@pytest.mark.flake8
def test_flake8(pytestconfig: pytest.Config) -> None:
    # flake8 checks each file by itself. A file that passed does not change its outcome.
    checked = pytestconfig.cache.get('opencv_tools/flake8', {})
    hashes = flake8_hashes()
    changed = [path for path, digest in hashes.items() if checked.get(path) != digest]
    if changed:
        check('ament_flake8', '--linelength', '99', *changed)
    pytestconfig.cache.set('opencv_tools/flake8', hashes)


@pytest.mark.process
@pytest.mark.linter
@pytest.mark.flake8
def test_flake8_failure_shows_only_the_findings(tmp_path: Path) -> None:
    (tmp_path / 'good.py').write_text('')
    (tmp_path / 'bad.py').write_text('import os\n')
    with pytest.raises(pytest.fail.Exception) as failure:
        check('ament_flake8', str(tmp_path))
    assert re.search(r"bad\.py:1:1: F401 'os' imported but unused", str(failure.value))
    assert 'good.py' not in str(failure.value)


@pytest.mark.process
@pytest.mark.linter
@pytest.mark.pep257
def test_pep257() -> None:
    check('ament_pep257', *(path for path in CODE if path != 'test'))


@pytest.mark.process
@pytest.mark.linter
@pytest.mark.copyright
def test_copyright() -> None:
    check(tool('ament_copyright', 'sudo apt install python3-ament-copyright'), *CODE)


@pytest.mark.linter
@pytest.mark.copyright
def test_licence_header_of_source_files() -> None:
    files = [path for folder in CODE for path in ROOT.glob(f'{folder}/**/*.py')]
    header = (ROOT / 'setup.py').read_text().partition('\n\n')[0]
    assert 'Licensed under the Apache License, Version 2.0' in header
    assert [path for path in files
            if path.read_text() and not path.read_text().startswith(header)] == []


@pytest.mark.process
@pytest.mark.linter
@pytest.mark.xmllint
def test_xmllint() -> None:
    check(tool('ament_xmllint', 'sudo apt install python3-ament-xmllint'), 'package.xml')


#: Options of tsc. The pages do without the checks of null, as the elements of a page exist.
TYPES = {'allowJs': True, 'checkJs': True, 'strict': True, 'strictNullChecks': False,
         'noImplicitAny': False, 'declaration': True, 'emitDeclarationOnly': True,
         'target': 'esnext', 'module': 'esnext', 'moduleResolution': 'bundler', 'types': [],
         'lib': ['esnext', 'dom', 'dom.iterable']}
#: Pages; the second one uses a module of the first one.
PAGES = [str(ROOT / 'opencv_tools' / path) for path in ('viewer/page', 'robot/view/page')]


def typescript(folder: Path) -> list[str]:
    """Find the compiler tsc, or install it, where node is."""
    if path := shutil.which('tsc'):
        return [path]
    return [str(installed('typescript@5.9', folder) / '.bin' / 'tsc')]


@pytest.fixture(scope='module')
def declarations(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Check the types of the pages; return the declarations of what their modules export."""
    folder = tmp_path_factory.mktemp('types')
    (folder / 'three.d.ts').write_text('declare var THREE: any;\n')
    (folder / 'tsconfig.json').write_text(json.dumps({
        'compilerOptions': {**TYPES, 'rootDirs': PAGES, 'outDir': str(folder / 'out')},
        'include': [*(f'{page}/*.js' for page in PAGES), 'three.d.ts'],
        'exclude': [f'{PAGES[1]}/three.js']}))
    check(*typescript(folder), '--project', str(folder))
    return '\n'.join(path.read_text() for path in (folder / 'out').rglob('*.d.ts'))


@pytest.mark.process
@pytest.mark.linter
def test_types_of_the_pages(declarations: str) -> None:
    assert 'import type { Request }' in declarations


@pytest.mark.process
@pytest.mark.linter
def test_exported_functions_of_the_pages_have_types(declarations: str) -> None:
    exported = re.findall(r'^export (?:declare )?function .*?;$', declarations,
                          re.MULTILINE | re.DOTALL)
    assert len(exported) > 20
    assert [text for text in exported if re.search(r'\w+\??: any[,)]|^    \w+: any;', text,
                                                   re.MULTILINE)] == []


@pytest.mark.linter
def test_package_xml_for_colcon_and_rosdep() -> None:
    warnings: list[str] = []
    package = parse_package(ROOT / 'package.xml', warnings=warnings)
    package.validate(warnings=warnings)
    assert not warnings
    assert (package.package_format, package.get_build_type()) == (3, 'ament_python')


@pytest.mark.linter
def test_version_is_that_of_the_newest_release() -> None:
    package = parse_package(ROOT / 'package.xml')
    releases = re.findall(r'^(\d+\.\d+\.\d+) \(\d{4}-\d\d-\d\d\)$',
                          (ROOT / 'CHANGELOG.rst').read_text(), re.MULTILINE)
    assert releases[0] == package.version
    assert f"version='{package.version}'" in (ROOT / 'setup.py').read_text()


@pytest.mark.linter
def test_rosdep_keys_exist() -> None:
    package = parse_package(ROOT / 'package.xml')
    kinds = ('buildtool', 'build', 'build_export', 'buildtool_export', 'exec', 'test', 'doc')
    keys = {dependency.name for kind in kinds
            for dependency in getattr(package, f'{kind}_depends')}
    assert len(keys) > 20
    assert sorted(keys - RELEASED - SYSTEM_KEYS) == []


@pytest.mark.linter
def test_xml_files_are_well_formed() -> None:
    files = [path for folder in ('urdf', 'sdf') for path in (ROOT / folder).rglob('*.*')]
    assert len(files) == 7
    for path in files:
        ElementTree.parse(path)


@pytest.mark.process
@pytest.mark.linter
def test_ruff() -> None:
    check(tool('ruff', 'pip install ruff'), 'check', *CODE)


@pytest.mark.process
@pytest.mark.linter
def test_mypy() -> None:
    check(tool('mypy', 'sudo apt install mypy'), '--strict', 'opencv_tools')
