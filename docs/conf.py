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

"""Configuration of Sphinx for ``make docs`` and rosdoc2."""

from __future__ import annotations

from pathlib import Path
import re
import xml.etree.ElementTree as ElementTree

from sphinx.application import Sphinx

ROOT = Path(__file__).parent.parent

project = 'opencv_tools'
author = 'opencv_tools maintainers'
copyright = f'2026, {author}'  # noqa: A001
if (ROOT / 'package.xml').is_file():  # rosdoc2 copies the pages elsewhere and sets the version
    release = version = ElementTree.parse(ROOT / 'package.xml').findtext('version', '')

extensions = ['myst_parser', 'sphinx.ext.autodoc']
html_theme = 'furo'

myst_heading_anchors = 4

autodoc_member_order = 'bysource'
autodoc_default_options = {'members': True, 'show-inheritance': True}

# References that lead to no page: to other modules than the public ones, to private names, to
# aliases and to type variables.
_PUBLIC = re.findall(r'automodule:: (\S+)', Path(__file__).with_name('api.rst').read_text())
nitpick_ignore_regex = [
    ('py:.*', rf'(?!(?:{"|".join(_PUBLIC)})\.)\w+\..*'), ('py:.*', r'.*\._\w+'),
    ('py:.*', 'CameraRequest|CycleError|Matrix|OnBroken|Source|Vector'),
    ('py:.*', r'.*\.(ElementT|P|T)')]

#: Files of the root folder that are pages here.
PAGES = {'CONTRIBUTING.md': 'contributing.md', 'CHANGELOG.rst': 'changelog.rst'}


def moved_links(text: str) -> str:
    """Return a text of the root folder with links that fit the folder of the pages."""
    return re.sub(r'\]\((?!#|\w+:)(docs/)?', lambda link: '](' if link[1] else '](../', text)


def insert_page(app: Sphinx, docname: str, source: list[str]) -> None:
    """Replace the pages ``contributing`` and ``changelog`` by the texts of the root folder."""
    for file, page in PAGES.items():
        if docname == Path(page).stem and (ROOT / file).is_file():
            source[0] = moved_links((ROOT / file).read_text(encoding='utf-8'))
    for file, page in PAGES.items():
        source[0] = source[0].replace(f'](../{file}', f']({page}')


def setup(app: Sphinx) -> None:
    """Connect the changes of pages."""
    app.connect('source-read', insert_page)
