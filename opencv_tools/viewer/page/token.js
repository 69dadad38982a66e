// Copyright 2026 opencv_tools maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

// A link from another site comes without the cookie. The browser may have one nevertheless.
fetch('/topics').then((answer) => answer.ok && location.reload());

const address = new URL(location.href);
document.getElementById('wrong').hidden = !address.searchParams.has('token');
address.searchParams.delete('token');
history.replaceState(null, '', address);
