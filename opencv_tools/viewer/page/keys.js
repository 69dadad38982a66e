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

/**
 * Call actions at keys, unless the key belongs to the element with the focus.
 *
 * @param actionOf returns the present action of a key by its name; undefined for none.
 */
export function listenToKeys(actionOf) {
  document.addEventListener('keydown', (event) => {
    const isTyping = event.target.closest('input:not([type=checkbox], [type=range])') && event.key !== 'Escape';
    const isPressing = (event.key === ' ' && event.target.closest('button, summary'))
      || (/ |Arrow/.test(event.key) && event.target.closest('input, select'));
    const action = actionOf(event.key.length === 1 ? event.key.toLowerCase() : event.key);
    const isShortcut = event.ctrlKey || event.metaKey || event.altKey;
    if (!action || isTyping || isPressing || isShortcut) return;
    event.preventDefault();
    action();
  });
}
