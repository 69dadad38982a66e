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

const LEAST_VIEWS = 4;
const GREEN = 130; // hue
const LENSES = {
  plumb_bob: 'Usual lens (plumb_bob)',
  rational_polynomial: 'Wide lens (rational_polynomial)',
  equidistant: 'Fisheye lens (equidistant)',
};

const part = (id) => document.getElementById(id);

/** The result with its verdict, and the buttons to save it. */
export class Result {
  #shown = '';
  #number; // of the result that is shown

  /**
   * Create an object without a result.
   *
   * @param send sends a message to the session.
   * @param query names the topic in an address.
   */
  constructor(send, query) {
    this.query = query;
    part('solve').addEventListener('click', () => send({ solve: part('model').value }));
    part('save').addEventListener('click', () => send({ save: this.#number }));
    part('restore').addEventListener('click', () => send({ restore: true }));
  }

  connected({ models }) {
    if (!part('model').length) {
      part('model').replaceChildren(...models.map((name) => new Option(LENSES[name] ?? name, name)));
    }
  }

  show({ board, views, result, stale, busy, restorable }) {
    part('solution').hidden = !board;
    part('solve').disabled = views.length < LEAST_VIEWS || Boolean(busy);
    part('save').disabled = part('restore').disabled = Boolean(busy);
    part('restore').hidden = !restorable;
    part('result').hidden = !result;
    const shown = JSON.stringify([result, stale]);
    if (shown === this.#shown || !result) return;
    this.#shown = shown;
    this.#number = result.number;
    part('file').href = `/calibrate/camera.yaml?${this.query}&result=${result.number}`;
    if (!stale) part('solution').scrollIntoView({ block: 'nearest' });
    part('verdict').dataset.verdict = result.verdict;
    part('verdict').textContent = `The calibration is ${result.verdict}.`
      + (stale ? ' The views have changed: solve again.' : '');
    part('reasons').replaceChildren(...result.reasons.map((text) => make('li', text)));
    part('numbers').replaceChildren(...facts(result).map(([name, text]) => {
      const line = make('div');
      line.append(make('dt', name), make('dd', text));
      return line;
    }));
    this.#showHeat(result.cells);
  }

  /** Show the errors of the cells; the colours are from green to red, for the worst cell. */
  #showHeat(cells) {
    const worst = Math.max(...cells.flat().map((error) => error ?? 0), 1e-9);
    part('heat').tBodies[0].replaceChildren(...cells.map((row) => {
      const line = make('tr');
      line.append(...row.map((error) => {
        const cell = make('td', error === null ? '–' : error.toFixed(2));
        if (error !== null) {
          cell.style.backgroundColor = `hsl(${GREEN * (1 - error / worst)} 60% 78%)`;
        }
        return cell;
      }));
      return line;
    }));
  }
}

/** Return a new element with a text. */
function make(name, text = '') {
  const element = document.createElement(name);
  element.textContent = text;
  return element;
}

/** Return names and texts of the numbers of a result. */
function facts({ rms, held_out: heldOut, views, lens, distortion, model, bend_mm: bend }) {
  return [
    ['Error of the corners', `${rms.toFixed(3)} pixels in ${views} views`],
    ['Error of views left out', heldOut === null ? 'needs 10 views' : `${heldOut.toFixed(3)} pixels`],
    ...lens.map(({ name, value, deviation }) => [
      name, `${value.toFixed(2)} ± ${deviation === null ? '?' : deviation.toFixed(2)} pixels`]),
    [model, distortion.join(', ')],
    ...(bend ? [['Bend of the board', `${bend.toFixed(1)} mm`]] : []),
  ];
}
