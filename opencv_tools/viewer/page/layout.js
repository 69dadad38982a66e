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

// The layout of the page: which tiles it shows, where, and what its head says.

import { part, shortNames, showName, showState } from './page.js';
import { addressWith } from './state.js';
import { isRectified } from './tiles.js';

const GAP = 16; // pixels between tiles
const CAPTION = 60; // pixels of the texts below a picture
const LEAST_TILE = 280; // width in pixels
const SAY_MS = 5000;
const MORE_TOOLS = ['choose', 'full', 'calibrate', 'link', 'plain-link']; // beside a picture
const PHONE = 700; // pixels of a width, as in viewer.css
const LONG = 48; // characters of a title

/**
 * Return the columns and the width of tiles that are all on the screen, as large as possible.
 *
 * If the pictures were too small, the tiles fill the width, and the page scrolls.
 */
function fit(count, width, height, caption, ratio, least) {
  let best = { score: 0, columns: 1, tile: 0 };
  for (let columns = 1; columns <= count; columns += 1) {
    const rows = Math.ceil(count / columns);
    const tile = Math.min((width + GAP) / columns - GAP,
      ((height + GAP) / rows - GAP - caption) * ratio);
    const score = tile * Math.sqrt(count / (rows * columns)); // few gaps in the last row
    if (tile >= least && score > best.score) best = { score, columns, tile };
  }
  if (best.score) return best;
  const most = Math.floor((width + GAP) / (least + GAP));
  const columns = Math.max(1, Math.min(count, most));
  return { columns, tile: (width + GAP) / columns - GAP };
}

/** Places the tiles and shows the state of the page. */
export class Layout {
  #page;
  #said = { tile: undefined, isQuiet: false, at: 0 }; // to screen readers
  #cameras = part('cameras');
  #more = part('more-tools');
  #moved = MORE_TOOLS.map(part);
  #panel = part('panel'); // in the tile that is shown alone, or beside the tiles

  /**
   * @param {import('./viewer.js').Page} page
   * @param {import('./tiles.js').Tiles} tiles
   */
  constructor(page, tiles) {
    this.#page = { ...page, tiles };
  }

  /** Number of the columns. */
  get columns() {
    return Number(this.#cameras.style.getPropertyValue('--columns'));
  }

  /** Show one topic or all, as somebody has chosen. */
  update() {
    const { state: { selected, isPaused, node }, tiles, robot, steps, arrangement } = this.#page;
    document.body.dataset.view = selected ? 'one' : 'all';
    const title = selected || (node.host ? `Cameras of ${node.host}` : 'Cameras');
    const isLong = selected.length > LONG;
    showName(part('title'), title, isLong ? shortNames([...tiles.keys()]).get(title) : title);
    part('pause').ariaPressed = isPaused;
    part('pause').querySelector('span').textContent = isPaused ? 'Resume' : 'Pause';
    const { turns, isFlipped } = arrangement.turned(tiles.alone);
    part('save-turned').hidden = !turns && !isFlipped;
    part('previous').hidden = part('next').hidden = tiles.size < 2;
    robot.show(!selected, isPaused);
    steps.show(isPaused);
    part('calibrate').hidden = !node.control || !selected || isRectified(selected);
    part('calibrate').href = `/calibrate?topic=${encodeURIComponent(selected)}`;
    const { alone } = tiles;
    const { range, colors } = tiles.get(selected) ?? {};
    if (alone !== selected) Object.assign(tiles.get(alone), { range, colors });
    part('rectified').hidden = part('rectified-key').hidden = !tiles.rectifiedOf(selected);
    part('rectified').ariaPressed = alone !== selected;
    this.#placeTiles();
    this.#showChoices();
    for (const [name, tile] of tiles) {
      if (selected) tile.link.removeAttribute('href');
      else tile.link.href = addressWith(tiles.settingsOf(name));
    }
    const filling = document.fullscreenElement;
    if (filling && filling !== tiles.get(alone)?.element) document.exitFullscreen();
    this.#fitHead();
    this.show();
  }

  /** Leave out words of buttons for which the head of the page has no room. */
  #fitHead(head = document.querySelector('header')) {
    for (const words of ['all', 'most', 'none']) {
      head.dataset.words = words;
      if (head.scrollWidth <= head.clientWidth) return;
    }
  }

  /** Show the tiles in the order and as somebody has arranged them. */
  #placeTiles() {
    const { tiles, arrangement } = this.#page;
    const listed = arrangement.list([...tiles.keys()]);
    const pair = tiles.alone ? [tiles.alone, tiles.beside] : null;
    const active = /** @type {HTMLElement} */ (document.activeElement);
    const { children } = this.#cameras;
    const short = shortNames((pair ?? listed).filter(Boolean));
    [...new Set([...pair ?? [], ...listed].filter(Boolean))].forEach((name, place) => {
      const { element } = tiles.get(name);
      if (children[place] !== element) this.#cameras.insertBefore(element, children[place]);
    });
    if (document.activeElement !== active) active.focus(); // it was in a moved tile
    for (const [name, tile] of tiles) {
      tile.element.hidden = !short.has(name);
      showName(tile.element.querySelector('.name'), name, short.get(name));
      tile.view.turn(arrangement.turned(name));
      tile.element.querySelector('[data-arrange=pin]').ariaPressed = arrangement.has('pin', name);
    }
    const home = pair && !pair[1] ? tiles.get(pair[0])?.element.querySelector('.side') : null;
    const place = home ?? part('content');
    if (this.#panel.parentElement !== place) place.append(this.#panel);
    (pair ? this.#more : part('tools')).append(...this.#moved);
    part('none').hidden = !tiles.size || listed.length > 0;
  }

  /** Show what can be chosen for the arrangement, and what is chosen. */
  #showChoices() {
    const { tiles, arrangement } = this.#page;
    const names = [...tiles.keys()];
    document.body.toggleAttribute('data-beside', tiles.beside !== '');
    const hidden = names.filter((name) => arrangement.has('hide', name)).length;
    part('unhide').hidden = !hidden;
    part('unhide').textContent = `Show ${hidden} hidden`;
    part('search').hidden = part('size').hidden = part('beside').hidden = names.length < 2;
    const others = ['', ...names.sort().filter((name) => name !== tiles.alone)]
      .map((name) => new Option(name || 'Beside: none', name));
    const list = (options) => Array.from(options, ({ value }) => value).join();
    if (list(others) !== list(part('beside').options)) part('beside').replaceChildren(...others);
    part('beside').value = tiles.beside;
    part('size').value = arrangement.get('size');
    if (part('search') !== document.activeElement) {
      part('search').value = arrangement.get('search');
    }
  }

  /** Show what changes by itself: the state of the page and the facts of each tile. */
  show() {
    const { state: { selected, isPaused, node }, connection, tiles, robot } = this.#page;
    const { range, overlays, controls, recording } = this.#page;
    const { mood } = connection;
    const present = mood === 'live' && isPaused ? 'paused' : mood;
    part('controls').inert = mood !== 'live';
    recording.know(mood === 'live');
    document.title = (recording.isOn && mood === 'live' ? '● ' : '')
      + [selected || 'Cameras', node.host].filter(Boolean).join(selected ? ' – ' : ' of ');
    showState(present, node.host ? 'Reconnecting' : 'Connecting');
    part('empty').hidden = tiles.size > 0 || robot.isShown || mood === 'lost';
    for (const tile of tiles.values()) tile.show(present);
    const one = tiles.get(tiles.alone);
    range.show(one?.status.range, one?.range, one?.colors, one?.status.unit);
    one?.look.ask();
    overlays.show(Boolean(selected));
    controls.show(tiles.get(selected)?.topic?.nodes ?? []);
    if (present === 'live') this.#announce(one);
    const head = document.querySelector('header');
    if (head.scrollWidth > head.clientWidth) this.#fitHead(head); // a button has appeared
    this.#arrange(one);
    tiles.ask();
  }

  /** Tell screen readers that the picture that is shown alone has stopped, or comes again. */
  #announce(tile) {
    const isQuiet = Boolean(tile?.element.classList.contains('quiet'));
    const { tile: last, isQuiet: wasQuiet, at } = this.#said;
    if (last === tile && (wasQuiet === isQuiet || Date.now() < at + SAY_MS)) return;
    const sentence = isQuiet ? tile.link.title : 'Pictures arrive again';
    part('said').textContent = last === tile ? sentence : '';
    this.#said = { tile, isQuiet, at: Date.now() };
  }

  /** Arrange the tiles; `one` is shown alone, or beside another one; undefined for all. */
  #arrange(one) {
    const { state: { selected }, tiles: { shown }, robot, arrangement } = this.#page;
    const count = shown.length + Number(!selected && robot.isShown);
    const size = Number(arrangement.get('size')) || 0; // least width, which may be off the screen
    const ratios = shown.map((tile) => tile.view.ratio).filter(Boolean);
    ratios.sort((first, second) => first - second);
    const ratio = one?.view.ratio || (ratios[ratios.length >> 1] ?? 16 / 9);
    const below = document.querySelector('footer').offsetHeight + part('more').offsetHeight + GAP;
    const height = innerHeight - part('content').offsetTop - GAP - below;
    const single = one && count === 1 && innerWidth > PHONE ? one.element.querySelector('.look') : null;
    const { clientWidth } = single ?? this.#cameras; // without the panel
    // Only the texts of a single picture are off an upright screen.
    const scrolls = count === 1 && innerWidth < innerHeight && clientWidth / ratio < height;
    const captions = shown.map((tile) => tile.element.offsetHeight - tile.link.offsetHeight);
    const caption = !one ? Math.max(CAPTION, ...captions)
      : scrolls ? 0 : single ? single.offsetHeight + single.nextElementSibling.offsetHeight
        : one.element.offsetHeight - one.link.offsetHeight;
    const { columns, tile } = fit(count, clientWidth, size && !one ? 0 : height, caption, ratio,
      one && count === 1 ? 1 : (!one && size) || LEAST_TILE);
    this.#cameras.style.setProperty('--ratio', ratio);
    this.#cameras.style.setProperty('--columns', columns);
    this.#cameras.style.setProperty('--tile', `${tile}px`);
  }
}
