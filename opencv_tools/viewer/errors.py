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

"""The errors of the viewer."""

from __future__ import annotations

#: Longest message for a user in characters.
MAX_MESSAGE = 500


class ViewerError(Exception):
    """The viewer cannot start; the message includes the reason and the remedy."""


class RequestError(Exception):
    """A request of a browser cannot be fulfilled; the message is shown to its user."""

    def __init__(self, message: str, status: int = 400) -> None:
        super().__init__(message)
        self.status = status


class NoAnswerError(RequestError):
    """A node has not answered in time; it may still do what was requested."""


class WrongTokenError(RequestError):
    """A request has another token than that of the node."""
