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

// The tiles of the page: one for each topic, and that of the robot.

import { make, part } from './page.js';
import { keep, readAddress } from './state.js';
import { Tile } from './tile.js';
import { explainJpeg, readTopic } from './video.js';

/** @import { FileAnswer, Status, Topic } from '../messages.js' */

const SETTLE_MS = 100;
const REST = 4; // pauses of the robot for the time that it has taken
const SLOW = 0.5; // seconds of a delay of the pictures
const MOST_SLOW = 3; // delays within
const SLOW_MS = 300000;
const KEPT_MS = 10000; // the browser has read the file by then
const NO_CHARTS = 'The browser decodes this video, so the node has no pixels of it. Pause the page, or add '
  + 'quality=90 to its address to get images.';
const RECTIFIED = 'image_rect'; // name of image_proc, which img_publisher uses as well
const RAW = /\/image(_raw)?$/; // names of images that a node of its own rectifies

/** Return whether a topic has rectified pictures by its name, such as image_rect_color. */
export const isRectified = (/** @type {string} */ name) => (
  name.slice(name.lastIndexOf('/') + 1).startsWith(RECTIFIED));

/** The tiles of all topics by the name of the topic. */
export class Tiles extends Map {
  #page;
  #numbers = new Map(); // of topics, as in the head of a frame
  #isExplained = false;
  #settle = 0;
  #sizes = new ResizeObserver(() => this.#askSoon());
  #inView = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      const tile = this.get(/** @type {HTMLElement} */ (target).dataset.topic);
      if (tile?.element === target) tile.inView = isIntersecting;
    }
    this.ask();
  }, { rootMargin: '100px' });

  /** @param {import('./viewer.js').Page} page */
  constructor(page) {
    super();
    this.#page = page;
  }

  /** Topic that is shown alone, which may be the rectified one; '' for all topics. */
  get alone() {
    const { selected } = this.#page.state;
    return (this.get(selected)?.isRectified && this.rectifiedOf(selected)) || selected;
  }

  /** Topic beside that which is shown alone; '' for none. */
  get beside() {
    const name = this.#page.state.selected && this.#page.arrangement.get('beside');
    return this.has(name) && name !== this.alone ? name : '';
  }

  /** Tiles that are shown. */
  get shown() {
    return [...this.values()].filter((tile) => !tile.element.hidden);
  }

  /** Return the topic with the rectified pictures of one; '' for none. @param {string} name */
  rectifiedOf(name) {
    const other = `${name.slice(0, name.lastIndexOf('/'))}/${RECTIFIED}`;
    const nodes = this.get(other)?.topic?.nodes;
    if (other === name || !nodes) return '';
    const own = this.get(name)?.topic?.nodes ?? [];
    return RAW.test(name) || nodes.some((node) => own.includes(node)) ? other : '';
  }

  /** Return what the address says of a topic that is shown alone. @param {string} topic */
  settingsOf(topic) {
    const { range, colors, isRectified: rectified } = this.get(topic) ?? {};
    return { topic, range: range?.join(), colors, rectified: rectified && 'true' };
  }

  /** Create the tile of a topic. @param {string} name */
  add(name) {
    const { connection, state, select } = this.#page;
    const tile = new Tile(name, connection, () => this.#askSoon(), (place) => {
      for (const other of this.shown) if (other !== tile) other.look.follow(place);
    });
    this.set(name, tile);
    tile.link.addEventListener('click', (event) => {
      if (event.ctrlKey || event.metaKey || event.shiftKey) return;
      event.preventDefault();
      if (!state.selected) select(name);
    });
    this.#inView.observe(tile.element);
    this.#sizes.observe(tile.link);
    return tile;
  }

  #remove(name, tile) {
    this.#inView.unobserve(tile.element);
    this.#sizes.unobserve(tile.link);
    tile.ask(false, {});
    part('content').append(...tile.element.querySelectorAll('#panel')); // it is of the page
    tile.element.remove();
    this.delete(name);
  }

  /** Create and remove tiles so that they are those of the topics. @param {Topic[]} topics */
  list(topics) {
    const { selected } = this.#page.state;
    const names = topics.map((topic) => topic.name);
    if (selected && !names.includes(selected)) names.push(selected);
    for (const [name, tile] of this) if (!names.includes(name)) this.#remove(name, tile);
    this.#numbers.clear();
    for (const tile of this.values()) tile.topic = null;
    for (const topic of topics) {
      const tile = this.get(topic.name) ?? this.add(topic.name);
      if (tile.refusal) tile.reset();
      tile.topic = topic;
      this.#numbers.set(topic.id, tile);
    }
    for (const name of names) if (!this.has(name)) this.add(name);
  }

  /** Remove tiles without a topic, which are there only while they are selected. */
  listAgain() {
    this.list([...this.values()].map((tile) => tile.topic).filter(Boolean));
  }

  /** Use the states of topics. @param {Status[]} list */
  receive(list) {
    for (const status of list) {
      const tile = this.get(status.name);
      if (tile) {
        tile.status = status;
        this.#numbers.set(status.id, tile);
      }
    }
  }

  /** Show a frame, and answer the node. @param {ArrayBuffer} bytes */
  frame(bytes) {
    const { connection, state } = this.#page;
    const { id, isVideo } = readTopic(bytes);
    const tile = this.#numbers.get(id);
    if (tile && isVideo) tile.decode(bytes);
    else if (tile) tile.draw(bytes).then(() => state.isPaused && this.ask());
    else connection.send({ got: new DataView(bytes).getUint32(4) });
  }

  /** Return whether to ask for the video of a topic. */
  #takesVideo(tile) {
    const { state: { node, codecs, isFixed }, notify } = this.#page;
    const isVideo = node.video === 'always'
      || (node.video === 'auto' && (tile.topic?.transports.includes('video') ?? true));
    if (isVideo && !codecs.length && tile.topic && !this.#isExplained && !isFixed) {
      this.#isExplained = true;
      notify(explainJpeg(node.host));
    }
    return isVideo && codecs.length > 0 && !tile.refusesVideo;
  }

  /** Ask for other pictures, but not with each step of a movement. */
  #askSoon() {
    this.#settle ||= setTimeout(() => {
      this.#settle = 0;
      this.ask();
    }, SETTLE_MS);
  }

  /** Ask for the pictures that somebody sees. */
  ask() {
    const { alone, beside } = this;
    for (const tile of this.values()) {
      this.#askFor(tile, Boolean(alone) && [alone, beside].includes(tile.name));
    }
  }

  /** Ask for the pictures of a tile; `looks` is whether somebody may look into them. */
  #askFor(tile, looks) {
    const { state: { node, fixed, isPaused }, overlays } = this.#page;
    const width = node.widths.find((step) => step >= tile.view.width) ?? 0;
    const needsImages = tile.needsImages(looks)
      || (looks && overlays.hasBoxes); // whose pictures may wait for them, unlike video
    const held = looks && isPaused && tile.isKept; // so that its pixels can still be looked at
    const isVideo = this.#takesVideo(tile) && !needsImages && !held;
    tile.look.offer(isVideo && !tile.hasImages ? NO_CHARTS : '');
    const isSeen = tile.inView && !tile.element.hidden;
    const isWanted = held || (isSeen && !document.hidden && !isPaused);
    tile.ask(isWanted, { width, ...(isVideo ? { video: true } : fixed),
      ...(looks && { looks }), ...(held && { held }) });
    tile.overlay.show(looks ? overlays.chosen : {}, looks && isWanted ? overlays.request : null);
  }
}

/**
 * Save a picture in the format of the recorder.
 * @param {FileAnswer} file
 * @param {{ turns: number, isFlipped: boolean }} way how the page shows it.
 * @param {boolean} isTurned whether the file has it as the page shows it.
 * @returns {Promise<string>} the sentence about it.
 */
export async function savePicture({ address, error }, { turns, isFlipped }, isTurned) {
  if (error) return error;
  const turn = isTurned ? `&turn=${turns}${isFlipped ? 'f' : ''}` : '';
  const answer = await fetch(address + turn).catch(
    (err) => new Response(err.message, { status: 503 }));
  if (!answer.ok) return (await answer.text()).trim();
  const name = /filename="([^"]+)"/.exec(answer.headers.get('Content-Disposition') ?? '');
  const way = isTurned ? ' as it is shown'
    : turns || isFlipped ? ' as the camera has sent it, neither turned nor flipped' : '';
  return download(await answer.blob(), name ? name[1] : 'picture') + way;
}

function download(blob, name) {
  const href = URL.createObjectURL(blob);
  make('a', { href, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(href), KEPT_MS);
  return `Saved ${name}`;
}

/**
 * Save a picture of a video, which only the browser has decoded.
 * @param {Tile} tile
 * @param {{ turns: number, isFlipped: boolean }} way
 */
export async function saveVideo({ canvas, name, stamp }, { turns, isFlipped }) {
  const { width, height } = canvas;
  const isSideways = turns % 2;
  const file = new OffscreenCanvas(isSideways ? height : width, isSideways ? width : height);
  const context = file.getContext('2d');
  context.translate(file.width / 2, file.height / 2);
  context.rotate((turns * Math.PI) / 2);
  context.scale(isFlipped ? -1 : 1, 1);
  context.drawImage(canvas, -width / 2, -height / 2);
  const blob = await file.convertToBlob();
  return `${download(blob, `${name.slice(1).replaceAll('/', '_')}_${stamp.toFixed(6)}.png`)
  } from the decoded video`;
}

/** The robot in the grid: its own page in a frame, which exists while it is shown. */
export class Robot {
  #button = part('show-robot');
  #element = null;
  #isPublished = false;
  #isHidden = readAddress().get('robot') === 'hidden';
  #onChange;
  #isHeld = false;
  #rest = 0; // timer of a pause for the pictures
  #draws; // so far
  /** @type {number[]} */
  #slow = []; // times of long delays

  /** @param {() => void} onChange called when the tile appears or disappears. */
  constructor(onChange) {
    this.#button.addEventListener('click', () => {
      this.#isHidden = !this.#isHidden;
      keep({ robot: this.#isHidden && 'hidden' });
      onChange();
    });
    this.#onChange = onChange;
  }

  get isShown() {
    return Boolean(this.#element && !this.#element.hidden);
  }

  /**
   * Add the tile when the robot is published; it stays, so that it can say why nothing comes.
   * @param {boolean} isPublished
   */
  setPublished(isPublished) {
    this.#isPublished ||= isPublished;
    this.#onChange();
  }

  /**
   * Show or hide the tile.
   * @param {boolean} isAll whether the page shows all tiles.
   * @param {boolean} isPaused whether the page is paused.
   */
  show(isAll, isPaused) {
    this.#button.hidden = !this.#isPublished;
    this.#button.title = this.#isHidden ? 'Show the robot' : 'Hide the robot';
    this.#button.querySelector('span').textContent = this.#button.title;
    if (this.#isPublished && !this.#isHidden && !this.#element) {
      this.#element = part('robot-tile').content.firstElementChild.cloneNode(true);
      part('cameras').append(this.#element);
    }
    if (this.#isHidden) {
      this.#element?.remove();
      this.#element = null;
    }
    if (!this.#element) return;
    this.#element.hidden = !isAll;
    this.#isHeld = isPaused || !isAll;
    this.#hold();
  }

  #hold() {
    const frame = this.#element?.querySelector('iframe');
    if (!frame) return;
    const isHeld = this.#isHeld || Boolean(this.#rest) || this.#slow.length >= MOST_SLOW;
    frame.dataset.held = String(isHeld); // for a page that is not loaded yet
    frame.contentWindow?.robotView?.live?.hold(isHeld);
  }

  /**
   * Let the robot rest after a delay of the page, so that it takes a fifth of the time at most; a
   * robot that delays the pictures for long again and again is drawn no more.
   * @param {number} seconds
   */
  rest(seconds) {
    const draws = this.#element?.querySelector('iframe').contentWindow?.robotView?.stage?.draws;
    const isDrawn = draws !== this.#draws; // or the delay is of something else
    this.#draws = draws;
    if (!isDrawn || !this.isShown || this.#rest || this.#isHeld) return;
    const time = performance.now();
    this.#slow = this.#slow.filter((one) => time < one + SLOW_MS);
    if (seconds > SLOW) this.#slow.push(time); // short ones between them do not count
    this.#rest = setTimeout(() => {
      this.#rest = 0;
      this.#hold();
    }, REST * seconds * 1000);
    this.#element.querySelector('.reason').hidden = this.#slow.length < MOST_SLOW;
    this.#hold();
  }
}
