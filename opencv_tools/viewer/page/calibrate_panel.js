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

// The panel of a calibration: the board, the views, and the result.

import { make, part } from './page.js';

/** @import { Session, SessionHello, SessionRequest } from '../messages.js' */

/** @typedef {(message: SessionRequest) => void} Send sends a message to the session. */

const LAST = 'calibrated board'; // of localStorage
const WANTED_TILTS = 2;
const LEAST_VIEWS = 4;
const GREEN = 130; // hue
const LENSES = {
  plumb_bob: 'Usual lens (plumb_bob)',
  rational_polynomial: 'Wide lens (rational_polynomial)',
  equidistant: 'Fisheye lens (equidistant)',
};

/** The form of the board, with its printable files. */
export class Board {
  #chosen = '';

  /** @param {Send} send */
  constructor(send) {
    part('board').addEventListener('submit', (event) => {
      event.preventDefault();
      send({ board: part('board-text').value });
    });
    part('board-text').addEventListener('input', () => this.#link());
  }

  /** Offer the kinds of boards, each with its example. @param {SessionHello} hello */
  connected({ boards }) {
    const examples = boards.map((form) => form.split(' ').at(-1));
    part('boards').replaceChildren(...examples.map((text) => new Option(text)));
    part('board-text').value ||= localStorage.getItem(LAST) ?? examples[0];
    this.#link();
  }

  /** @param {Session} session */
  show({ board, note }) {
    if (board && board !== this.#chosen) {
      localStorage.setItem(LAST, board);
      part('board-text').value = board;
      this.#link();
    }
    this.#chosen = board;
    if (note) part('note').textContent = `Note: ${note}.`;
  }

  #link() {
    const board = encodeURIComponent(part('board-text').value);
    for (const kind of ['pdf', 'svg']) {
      part(kind).href = `/calibrate/board?format=${kind}&board=${board}`;
    }
  }
}

/** The list of views, and what is still missing. */
export class Views {
  #shown = '';
  #last; // number of the last view of the list

  /** @param {Send} send */
  constructor(send) {
    part('take').addEventListener('click', () => send({ take: true }));
    part('undo').addEventListener('click', () => send({ delete: this.#last }));
    part('resume').addEventListener('click', () => send({ resume: true }));
    part('discard').addEventListener('click', () => {
      if (confirm('Delete all views and the result?')) send({ discard: true });
    });
    part('list').addEventListener('click', ({ target }) => {
      const { number } = target.closest('button')?.dataset ?? {};
      if (number === undefined) return;
      send({ delete: Number(number) });
      part('undo').focus(); // the button of the view disappears
    });
  }

  /** @param {Session} session */
  show({ board, views, cells, tilts, progress, wanted, paused }) {
    part('views').hidden = !board;
    part('resume').hidden = !paused;
    part('take').hidden = paused;
    part('undo').disabled = part('discard').disabled = !views.length;
    part('progress').value = progress;
    const all = cells.flat();
    const covered = all.length ? all.filter(Boolean).length / all.length : 0;
    const percent = (value) => `${Math.round(100 * value)} %`;
    part('counts').textContent = `views: ${views.length} (${wanted.views} are enough), covered: `
      + `${percent(covered)} of the image (${percent(wanted.cells)} is enough)`;
    part('tilts').replaceChildren(...Object.entries(tilts).map(([side, count]) => {
      const item = make('li', {},
        `${side} nearer: ${Math.min(count, WANTED_TILTS)} of ${WANTED_TILTS}`);
      item.dataset.done = count >= WANTED_TILTS;
      return item;
    }));
    const shown = JSON.stringify(views);
    if (shown === this.#shown) return;
    this.#shown = shown;
    this.#last = views.at(-1)?.number;
    const worst = Math.max(0, ...views.map(({ error }) => error ?? 0));
    part('list').replaceChildren(...views.map((view, place) => row(view, place + 1, worst)));
    part('list').scrollTop = part('list').scrollHeight;
  }
}

/**
 * Return the line of a view.
 * @param {import('../messages.js').SessionView} view
 * @param {number} place
 * @param {number} worst error of all views.
 */
function row({ number, error, dropped }, place, worst) {
  const known = error !== undefined && error !== null;
  const words = dropped ? 'did not fit' : known ? `${error.toFixed(2)} pixels` : 'not solved yet';
  const bar = make('meter', { max: worst || 1, value: error ?? 0, hidden: !known,
    ariaHidden: 'true' });
  const button = make('button', { type: 'button', ariaLabel: `Delete view ${place}` }, 'Delete');
  button.dataset.number = number;
  return make('li', {}, make('span', {}, `View ${place}: ${words}`), bar, button);
}

/** The result with its verdict, and the buttons to save it. */
export class Result {
  #shown = '';
  #number; // of the result that is shown
  #query;

  /**
   * Create an object without a result.
   * @param {Send} send
   * @param {string} query names the topic in an address.
   */
  constructor(send, query) {
    this.#query = query;
    part('solve').addEventListener('click', () => send({ solve: part('model').value }));
    part('save').addEventListener('click', () => send({ save: this.#number }));
    part('restore').addEventListener('click', () => send({ restore: true }));
  }

  /** @param {SessionHello} hello */
  connected({ models }) {
    if (part('model').length) return;
    part('model').replaceChildren(...models.map((name) => new Option(LENSES[name] ?? name, name)));
  }

  /** @param {Session} session */
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
    part('file').href = `/calibrate/camera.yaml?${this.#query}&result=${result.number}`;
    if (!stale) part('solution').scrollIntoView({ block: 'nearest' });
    part('verdict').dataset.verdict = result.verdict;
    part('verdict').textContent = `The calibration is ${result.verdict}.`
      + (stale ? ' The views have changed: solve again.' : '');
    part('reasons').replaceChildren(...result.reasons.map((text) => make('li', {}, text)));
    part('numbers').replaceChildren(...facts(result).map(([name, text]) => (
      make('div', {}, make('dt', {}, name), make('dd', {}, text)))));
    showHeat(result.cells);
  }
}

/** Show the errors of the cells; the colours are from green to red, for the worst cell. */
function showHeat(cells) {
  const worst = Math.max(...cells.flat().map((error) => error ?? 0), 1e-9);
  const cellOf = (error) => {
    const cell = make('td', {}, error === null ? '–' : error.toFixed(2));
    const hue = GREEN * (1 - error / worst);
    if (error !== null) cell.style.backgroundColor = `hsl(${hue} 60% 78%)`;
    return cell;
  };
  part('heat').tBodies[0].replaceChildren(
    ...cells.map((line) => make('tr', {}, ...line.map(cellOf))));
}

/** Return names and texts of the numbers of a result. */
function facts({ rms, held_out: heldOut, views, lens, distortion, model, bend_mm: bend }) {
  return [
    ['Error of the corners', `${rms.toFixed(3)} pixels in ${views} views`],
    ['Error of views left out',
      heldOut === null ? 'needs 10 views' : `${heldOut.toFixed(3)} pixels`],
    ...lens.map(({ name, value, deviation }) => [
      name, `${value.toFixed(2)} ± ${deviation === null ? '?' : deviation.toFixed(2)} pixels`]),
    [model, distortion.join(', ')],
    ...(bend ? [['Bend of the board', `${bend.toFixed(1)} mm`]] : []),
  ];
}
