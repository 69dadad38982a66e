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

const UNITS = [[86400, 'd'], [3600, 'h'], [60, 'min'], [1, 's']];
const END = 16; // characters of a long name that are always shown

/** Return a number as text with at most one decimal. */
export const number = (value) => (Number.isFinite(value) ? String(Math.round(value * 10) / 10) : '');

/** Return a rate in Hz as text. */
export const rate = (value) => (Number.isFinite(value) ? `${value.toFixed(1)} Hz` : '');

/** Return the width and the height of an image as text, '' before the first image. */
export const size = ({ width, height }) => (width ? `${width} × ${height}` : '');

/** Return a duration in seconds as text. */
export function age(seconds) {
  if (!Number.isFinite(seconds)) return '';
  if (Math.abs(seconds) < 1) return `${Math.round(seconds * 1000)} ms`;
  const [length, unit] = UNITS.find(([least]) => Math.abs(seconds) >= least);
  const count = seconds / length;
  return `${length === 1 && Math.abs(count) < 10 ? count.toFixed(1) : Math.round(count)} ${unit}`;
}

/** Show a name, which is cut in its middle if it is too long: the ends of topics differ. */
export function showName(element, name) {
  if (element.title === name) return;
  element.title = name;
  const cut = name.length > END ? name.length - END : name.length;
  element.replaceChildren(...[name.slice(0, cut), name.slice(cut)].map((text) => {
    const span = document.createElement('span');
    span.textContent = text;
    return span;
  }));
}
