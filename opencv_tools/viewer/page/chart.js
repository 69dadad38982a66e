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

export const WIDTH = 256;
const HEIGHT = 100;

const percent = (value) => value && `${(100 * value).toFixed(value < 0.1 ? 2 : 0)} %`;

/** Return the path of numbers between two limits; null is a gap. */
export function path(numbers, low, high) {
  let pen = 'M';
  return numbers.map((number, place) => {
    const x = (place / (numbers.length - 1 || 1)) * WIDTH;
    const step = number === null ? '' : `${pen}${x} ${HEIGHT * (1 - (number - low) / (high - low || 1))}`;
    pen = step ? 'L' : 'M';
    return step;
  }).join('');
}

/** Show a histogram or the profile of a line in an element, or the reason why there is none. */
export function showChart(
  element, kind, { names, curves, low, high, over, under, missing, lacking, error },
) {
  const limits = kind === 'profile' ? [low, high] : [0, Math.max(...(curves ?? []).flat())];
  element.querySelector('svg').replaceChildren(...(curves ?? []).map((curve, place) => {
    const line = document.createElementNS('http://www.w3.org/2000/svg', 'path');
    line.setAttribute('d', path(curve, ...limits));
    line.dataset.channel = names[place];
    return line;
  }));
  const ends = Number.isFinite(low) && `${+low.toPrecision(6)} to ${+high.toPrecision(6)}`;
  element.querySelector('.hint').textContent = error ?? [ends,
    over > 0 && `${percent(over)} over-exposed`, under > 0 && `${percent(under)} black`,
    missing > 0 && `${percent(missing)} without ${lacking}`].filter(Boolean).join(', ');
  element.classList.toggle('over', over > 0);
}
