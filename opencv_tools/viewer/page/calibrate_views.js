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

const WANTED_TILTS = 2;

const part = (id) => document.getElementById(id);

/** The list of views, and what is still missing. */
export class Views {
  #send;
  #shown = '';
  #last; // number of the last view of the list

  /** @param send sends a message to the session. */
  constructor(send) {
    this.#send = send;
    part('take').addEventListener('click', () => send({ take: true }));
    part('undo').addEventListener('click', () => send({ delete: this.#last }));
    part('resume').addEventListener('click', () => send({ resume: true }));
    part('discard').addEventListener('click', () => {
      if (confirm('Delete all views and the result?')) send({ discard: true });
    });
    part('list').addEventListener('click', ({ target }) => {
      const { number } = target.closest('button')?.dataset ?? {};
      if (number === undefined) return;
      this.#send({ delete: Number(number) });
      part('undo').focus(); // the button of the view disappears
    });
  }

  show({ board, views, cells, tilts, progress, wanted, paused }) {
    part('views').hidden = !board;
    part('resume').hidden = !paused;
    part('take').hidden = paused;
    part('undo').disabled = part('discard').disabled = !views.length;
    part('progress').value = progress;
    const all = cells.flat();
    const covered = all.length ? all.filter(Boolean).length / all.length : 0;
    part('counts').textContent = `views: ${views.length} (${wanted.views} are enough), covered: `
      + `${Math.round(100 * covered)} % of the image (${Math.round(100 * wanted.cells)} % is enough)`;
    part('tilts').replaceChildren(...Object.entries(tilts).map(([side, count]) => {
      const item = document.createElement('li');
      item.dataset.done = count >= WANTED_TILTS;
      item.textContent = `${side} nearer: ${Math.min(count, WANTED_TILTS)} of ${WANTED_TILTS}`;
      return item;
    }));
    const shown = JSON.stringify(views);
    if (shown === this.#shown) return;
    this.#shown = shown;
    this.#last = views.at(-1)?.number;
    const worst = views.reduce((one, { error }) => Math.max(one, error ?? 0), 0);
    part('list').replaceChildren(...views.map((view, place) => row(view, place + 1, worst)));
    part('list').scrollTop = part('list').scrollHeight;
  }
}

/** Return the line of a view. */
function row({ number, error, dropped }, place, worst) {
  const item = document.createElement('li');
  const text = document.createElement('span');
  const bar = document.createElement('meter');
  const button = document.createElement('button');
  const known = error !== undefined && error !== null;
  const words = dropped ? 'did not fit' : known ? `${error.toFixed(2)} pixels` : 'not solved yet';
  text.textContent = `View ${place}: ${words}`;
  bar.max = worst || 1;
  bar.value = error ?? 0;
  bar.hidden = !known;
  bar.setAttribute('aria-hidden', 'true');
  button.type = 'button';
  button.dataset.number = number;
  button.textContent = 'Delete';
  button.setAttribute('aria-label', `Delete view ${place}`);
  item.append(text, bar, button);
  return item;
}
