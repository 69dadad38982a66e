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

const part = (id) => document.getElementById(id);

const LARGEST = 1e300; // of the node

/** Return two numbers that a comma separates, the lower one first; null for another text. */
export function readLimits(text) {
  const limits = (text ?? '').split(',').map(Number);
  const isValid = limits.length === 2 && limits[0] < limits[1]
    && limits.every((one) => Math.abs(one) <= LARGEST);
  return isValid ? limits : null;
}

/** Return the sentence about limits in the address that are not used; '' if there are none. */
export function explainLimits(text) {
  return !text || readLimits(text) ? ''
    : `The range ${text} is not used: give two numbers, the lower one first.`;
}

/** Return a number with its unit. */
const measure = (value, unit) => `${Number(value.toPrecision(4))} ${unit}`;

/** Form with the range and the colours of depth. */
export class RangeForm {
  #form = part('range');
  #onChange;

  /**
   * Listen to the form.
   *
   * @param onChange called with range, two numbers or null for automatic limits; and with colors.
   */
  constructor(onChange) {
    this.#onChange = onChange;
    this.#form.addEventListener('change', () => this.#change());
    this.#form.addEventListener('submit', (event) => event.preventDefault());
  }

  /**
   * Show the limits.
   *
   * @param used limits of the present picture; null if it has none.
   * @param chosen limits that somebody has chosen; null for automatic limits.
   * @param colors colours that somebody has chosen; '' for the first ones.
   * @param unit of depth; '' for other numbers.
   */
  show(used, chosen, colors, unit) {
    this.#form.hidden = !used;
    if (!used) return;
    for (const element of this.#form.querySelectorAll('[data-of]')) element.hidden = !unit;
    part('colors').value = colors || part('colors').options[0].value;
    part('bar').dataset.colors = part('colors').value;
    const [low, high] = chosen ?? used;
    part('bar-low').textContent = measure(low, unit);
    part('bar-high').textContent = measure(high, unit);
    part('automatic').checked = !chosen;
    for (const [place, input] of [part('low'), part('high')].entries()) {
      input.readOnly = !chosen;
      const isTyping = chosen && this.#form.contains(document.activeElement);
      if (!isTyping) input.value = chosen ? chosen[place] : Number(used[place].toPrecision(4));
    }
  }

  #change() {
    const limits = readLimits(`${part('low').valueAsNumber},${part('high').valueAsNumber}`);
    part('high').setCustomValidity(limits ? '' : 'Give two numbers, the lower one first.');
    const { value: colors, options: [first] } = part('colors');
    const isValid = part('automatic').checked || this.#form.reportValidity();
    if (isValid) this.#onChange({ range: part('automatic').checked ? null : limits,
      colors: colors === first.value ? '' : colors });
  }
}
