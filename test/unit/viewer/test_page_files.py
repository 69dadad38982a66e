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

"""Files of the page."""

from __future__ import annotations

import re

from opencv_tools.viewer.web.page_files import INDEX, read_page, TOKEN_FORM


def test_every_file_of_the_page_is_found() -> None:
    page = read_page()
    assert page[INDEX].content_type == 'text/html; charset=utf-8'
    for name, file in page.items():
        text = file.content.decode(errors='replace')
        for used in re.findall(r'["\'](?:/page/|\./)([\w.-]+)["\']', text):
            assert used in page, f'{name} uses {used}'


def test_page_obeys_its_policy() -> None:
    page = read_page()
    for name in (INDEX, TOKEN_FORM):
        text = page[name].content.decode()
        assert not re.search(r'<script(?![^>]* src=)|<style|\sstyle=|\son\w+=|https?://', text)
