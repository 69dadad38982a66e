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

// Curves of numbers: of the pixels of a picture, and of a topic in the last minutes.

import { age, make, number, rate, write } from './page.js';

/** @import { Chart, Status } from '../messages.js' */

const WIDTH = 256;
const HEIGHT = 100;
const SECONDS = 300;
const AGAIN = 3; // seconds by which the place of one restart differs
const TEXTS = { rate, age, lost: number };

const percent = (value) => value && `${(100 * value).toFixed(value < 0.1 ? 2 : 0)} %`;

/** Return the path of numbers between two limits; null is a gap. */
function path(numbers, low, high) {
  let pen = 'M';
  return numbers.map((number, place) => {
    const x = (place / (numbers.length - 1 || 1)) * WIDTH;
    const y = HEIGHT * (1 - (number - low) / (high - low || 1));
    const step = number === null ? '' : `${pen}${x} ${y}`;
    pen = step ? 'L' : 'M';
    return step;
  }).join('');
}

/**
 * Show a histogram or the profile of a line, or the reason why there is none.
 * @param {HTMLElement} element
 * @param {'histogram' | 'profile'} kind
 * @param {Chart} chart
 */
export function showChart(element, kind, chart) {
  const { names, curves, low, high, ends, over, under, missing, lacking, error } = chart;
  const limits = kind === 'profile' ? [low, high] : [0, Math.max(...(curves ?? []).flat())];
  element.querySelector('svg').replaceChildren(...(curves ?? []).map((curve, place) => {
    const line = document.createElementNS('http://www.w3.org/2000/svg', 'path');
    line.setAttribute('d', path(curve, ...limits));
    line.dataset.channel = names[place];
    return line;
  }));
  element.querySelector('.hint').textContent = error ?? [ends,
    over > 0 && `${percent(over)} over-exposed`, under > 0 && `${percent(under)} black`,
    missing > 0 && `${percent(missing)} without ${lacking}`].filter(Boolean).join(', ');
  element.classList.toggle('over', over > 0);
  const places = Object.entries({ smallest: chart.least, largest: chart.most });
  /** @type {(entry: any) => string} */
  const text = ([name, [value, x, y]]) => `${name} ${value} at ${x}, ${y}`;
  const found = places.filter(([, at]) => at);
  const list = element.querySelector('.buttons');
  while (list.children.length > found.length) list.lastChild.remove();
  found.forEach((one, place) => {
    const button = list.children[place] ?? list.appendChild(make('button', { type: 'button' }));
    write(button, text(one));
    button.dataset.at = JSON.stringify(one[1].slice(1));
  });
}

/** Curves of a topic in the last minutes, one value a second. */
export class History {
  #element;
  #samples = []; // oldest first
  #restarts = []; // seconds
  #lost = Infinity; // of the sample before

  /** @param {HTMLElement} element with the curves. */
  constructor(element) {
    this.#element = element;
  }

  /**
   * Add the values of this second, unless it has some.
   * @param {Partial<Status>} status
   * @param {number} seconds age of the picture.
   */
  add({ rate: frames, lost, restarted }, seconds) {
    const second = Math.floor(performance.now() / 1000);
    if (second <= this.#samples.at(-1)?.second) return;
    const more = Math.max(0, lost - this.#lost);
    this.#samples.push({ second, rate: frames, age: seconds, lost: more });
    this.#lost = lost;
    const restart = second - Math.round(restarted ?? Infinity);
    if (restart > (this.#restarts.at(-1) ?? -Infinity) + AGAIN) this.#restarts.push(restart);
    const isKept = (one) => one > second - SECONDS;
    this.#samples = this.#samples.filter((one) => isKept(one.second));
    this.#restarts = this.#restarts.filter(isKept);
    if (this.#element.checkVisibility()) this.#draw(second);
  }

  #draw(now) {
    const [{ second: begin }] = this.#samples;
    const marks = this.#restarts.map(
      (second) => `M${((second - begin) / (now - begin || 1)) * WIDTH} 0V100`).join('');
    for (const [name, text] of Object.entries(TEXTS)) {
      const figure = this.#element.querySelector(`[data-curve=${name}]`);
      const values = Array(now - begin + 1).fill(null);
      for (const one of this.#samples) {
        if (Number.isFinite(one[name])) values[one.second - begin] = one[name];
      }
      const known = values.filter((one) => one !== null);
      const [low, high] = [Math.min(...known), Math.max(...known)];
      const [curve, mark] = figure.querySelectorAll('path');
      curve.setAttribute('d', path(values, Math.min(0, low), high));
      mark.setAttribute('d', marks);
      figure.querySelector('span').textContent = known.length
        ? `${text(low)} to ${text(high)}` : '';
    }
    const count = this.#restarts.length;
    this.#element.querySelector('.hint').textContent = `Last ${age(now - begin + 1)}`
      + (count ? `, ${count} ${count > 1 ? 'restarts' : 'restart'}` : '');
  }
}
