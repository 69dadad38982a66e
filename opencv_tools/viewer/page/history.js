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

import { path, WIDTH } from './chart.js';
import { age, number, rate } from './text.js';

const SECONDS = 300;
const AGAIN = 3; // seconds by which the place of one restart differs
const TEXTS = { rate, age, lost: number };

/** Curves of a topic in the last minutes, one value a second. */
export class History {
  #element;
  #samples = []; // oldest first
  #restarts = []; // seconds
  #lost = Infinity; // of the sample before

  /** Begin without values; the element has the curves. */
  constructor(element) {
    this.#element = element;
  }

  /** Add the values of this second, unless it has some. */
  add({ rate: frames, lost, restarted }, seconds) {
    const second = Math.floor(performance.now() / 1000);
    if (second <= this.#samples.at(-1)?.second) return;
    this.#samples.push({ second, rate: frames, age: seconds, lost: Math.max(0, lost - this.#lost) });
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
      figure.querySelector('span').textContent = known.length ? `${text(low)} to ${text(high)}` : '';
    }
    const count = this.#restarts.length;
    this.#element.querySelector('.hint').textContent = `Last ${age(now - begin + 1)}`
      + (count ? `, ${count} ${count > 1 ? 'restarts' : 'restart'}` : '');
  }
}
