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

// What all pages of img_viewer have: elements, texts, and the head of the page.

const UNITS = [[86400, 'd'], [3600, 'h'], [60, 'min'], [1, 's']];

/** Return the element of the page with an id. @type {(id: string) => any} */
export const part = (id) => document.getElementById(id);

/** @type {(name: string, properties?: object, ...children: (Node | string)[]) => any} */
export function make(name, properties = {}, ...children) {
  const element = Object.assign(document.createElement(name), properties);
  element.append(...children);
  return element;
}

// A screen reader reads each change.
/** @type {(element: Element, text: string) => void} */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Return a number as text with at most one decimal. @type {(value: number) => string} */
export const number = (value) => (
  Number.isFinite(value) ? String(Math.round(value * 10) / 10) : '');

/** Return a rate in Hz as text. @type {(value: number) => string} */
export const rate = (value) => (Number.isFinite(value) ? `${value.toFixed(1)} Hz` : '');

/** Return a size as text. @type {(image: { width?: number, height?: number }) => string} */
export const size = ({ width, height }) => (width ? `${width} × ${height}` : '');

/** Return a duration in seconds as text. @type {(seconds: number) => string} */
export function age(seconds) {
  if (!Number.isFinite(seconds)) return '';
  if (Math.abs(seconds) < 1) return `${Math.round(seconds * 1000)} ms`;
  const [length, unit] = /** @type {[number, string]} */ (
    UNITS.find(([least]) => Math.abs(seconds) >= Number(least)));
  const count = seconds / length;
  return `${length === 1 && Math.abs(count) < 10 ? count.toFixed(1) : Math.round(count)} ${unit}`;
}

/**
 * Return the parts of names in which they differ, without the folders that all of them begin or
 * end with; a single name is whole.
 * @type {(names: string[]) => Map<string, string>}
 */
export function shortNames(names) {
  const paths = names.map((name) => name.split('/'));
  const most = names.length > 1 ? Math.min(...paths.map((path) => path.length)) - 1 : 0;
  const count = (at) => {
    let same = 0;
    while (same < most && paths.every((path) => path.at(at(same)) === paths[0].at(at(same)))) {
      same += 1;
    }
    return same;
  };
  const begin = count((place) => place);
  const end = Math.min(count((place) => -1 - place), most - begin);
  return new Map(names.map((name, place) => (
    [name, paths[place].slice(begin, paths[place].length - end).join('/')])));
}

/**
 * Show a name, or a part of it that is enough; the tip has the name.
 * @type {(element: HTMLElement, name: string, shown?: string) => void}
 */
export function showName(element, name, shown = name) {
  element.title = name;
  if (element.textContent === shown) return;
  element.replaceChildren(...shown.split(/(?<=[/_])/).flatMap((text) => [text, make('wbr')]));
}

/**
 * Return a function that shows a sentence below the head of the page; '' removes it.
 * @param {number} milliseconds after which a sentence disappears, unless it shall stay.
 */
export function createNotice(milliseconds) {
  let timer = 0;
  return function notify(sentence = '', disappears = true) {
    part('notice').textContent = sentence;
    part('notice').hidden = !sentence;
    clearTimeout(timer);
    if (sentence && disappears) timer = setTimeout(notify, milliseconds);
  };
}

// viewer.css turns gray what comes from a node that is silent.
/** @type {(state: 'live' | 'paused' | 'stalled' | 'lost', lost?: string) => void} */
export function showState(state, lost = 'Connecting') {
  document.body.dataset.mood = state;
  part('state').dataset.state = state;
  write(part('state'), { live: 'Live', paused: 'Paused', stalled: 'Stalled', lost }[state]);
}
