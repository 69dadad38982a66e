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

import { History } from './chart.js';
import { Look } from './look.js';
import { Overlay } from './overlay.js';
import { age, make, number, part, rate, showName, size } from './page.js';
import { Video } from './video.js';
import { View } from './view.js';

/** @import { Connection } from './connection.js' */
/** @import { Status, Topic } from '../messages.js' */

const RETRY_MS = 30000; // until the video is tried again after errors of the decoder
const PLACE = 24; // in the head: part of the image and its size, six numbers
const HEAD_BYTES = 48; // before stamp, number and frame_id
const CLOCK_BEGINS = 1e9; // an earlier stamp is a time of a simulation
const AGES = 30;
const OLD = 2; // seconds on the way, as the page was busy or the link is slow
const CLOCK = 'sv-SE'; // 24 hours; the year first

/** Picture of one topic with its facts. */
export class Tile {
  element = part('tile').content.firstElementChild.cloneNode(true);
  /** @type {Partial<Status>} */
  status = {};
  /** @type {Topic | null} */
  topic = null;
  /** @type {number[] | null} */
  range = null;
  colors = ''; // of depth; '' for the first ones
  isRectified = false; // whether the tile of the rectified pictures is shown instead
  inView = false;
  refusal = '';
  refusesVideo = false;
  #asked = '';
  #isLookedInto = false;
  #video = null;
  #askedAt = 0;
  #connected = {}; // another object after each reset
  #drawn = { sequence: -1, stamp: 0, origin: null, wasOld: false, from: 0, at: 0, period: 0, time: '', isVideo: false };
  #ages = [];
  #age = NaN;
  #history;
  #part = (name) => this.element.querySelector(name);

  /**
   * @param {string} name
   * @param {Connection} connection
   * @param {() => void} [onLook] called after a zoom; none for a picture that nobody looks into.
   * @param {(place?: number[]) => void} [onPoint] called with a place of the cursor.
   */
  constructor(name, connection, onLook, onPoint) {
    this.name = name;
    this.connection = connection;
    this.element.dataset.topic = name;
    showName(this.#part('.name'), name);
    this.canvas = this.#part('canvas');
    this.canvas.ariaLabel = `Picture of ${name}`;
    this.link = this.#part('.frame');
    this.context = this.canvas.getContext('2d', { alpha: false });
    this.view = new View(this.link, this.canvas);
    if (!onLook) return;
    this.#history = new History(this.#part('.history'));
    this.look = new Look(this, connection.send, onPoint);
    this.overlay = new Overlay(this);
    const { onPlace } = this.view;
    this.view.onPlace = () => {
      onPlace();
      this.look.move();
    };
    this.view.listen(() => {
      this.look.ask();
      onLook();
    }, (event) => this.look.use(event));
  }

  /** Sequence number of the image, for questions about it; -1 before the first one and for video. */
  get picture() {
    return this.isVideo ? -1 : this.#drawn.sequence;
  }

  /** Stamp, with its local date unless it is of a simulation, number and frame_id. */
  get origin() {
    const { stamp, origin } = this.#drawn;
    if (this.canvas.hidden) return [];
    const [, seconds, rest] = /^(\d*?)(\d{9})$/.exec(String(origin?.exact ?? '').padStart(10, '0'));
    const exact = origin ? `${seconds}.${rest}` : stamp.toFixed(6);
    const date = stamp > CLOCK_BEGINS ? ` (${new Date(stamp * 1000).toLocaleString(CLOCK)}.${
      exact.split('.')[1].slice(0, 3)})` : '';
    return [['Stamp', exact + date], ['Frame', [origin?.id && `frame_id ${origin.id}`,
      origin?.number && `sequence ${origin.number}`].filter(Boolean).join(', ')]];
  }

  /** Stamp of the picture in seconds. */
  get stamp() {
    return this.#drawn.stamp;
  }

  /** Whether the node can keep the picture while the page is paused. */
  get isKept() {
    return this.#asked !== '' && (this.isVideo || this.picture >= 0);
  }

  /** Whether the picture is one of a video, which the node does not decode. */
  get isVideo() {
    return this.#drawn.isVideo;
  }

  /** Whether there are messages with images, which have the values that a video has not. */
  get hasImages() {
    return Boolean(this.topic?.transports.some((one) => one !== 'video'));
  }

  /**
   * Return whether images are needed: somebody has looked into the picture.
   * @param {boolean} looks whether it is shown alone; the answer stays until it is not.
   */
  needsImages(looks) {
    this.#isLookedInto = looks
      && (this.#isLookedInto || Boolean(this.look.chart || this.look.marks
        || this.view.region));
    return this.#isLookedInto && this.hasImages;
  }

  /** Forget what was asked, because the connection is a new one or the topic appeared. */
  reset() {
    this.#asked = '';
    this.#connected = {};
    this.#drawn.sequence = -1;
    this.look?.reset();
    this.overlay?.reset();
    this.refusal = '';
    this.refusesVideo = false;
    this.#endVideo(false);
  }

  #endVideo(answers) {
    this.#video?.close(answers);
    this.#video = null;
  }

  /**
   * Ask the server for pictures, or for none, if that is not what it was asked last.
   * @param {boolean} wanted whether somebody looks.
   * @param {Partial<import('../messages.js').Subscribe>} options
   */
  ask(wanted, options) {
    const { connection } = this;
    if (!connection.isOpen || this.refusal) return;
    const request = { subscribe: this.name, ...options };
    if (this.range) request.range = this.range;
    if (this.colors) request.colors = this.colors;
    if (this.view.region && !request.video) request.region = this.view.region;
    const asked = wanted ? JSON.stringify(request) : '';
    if (asked === this.#asked) return;
    if (!this.#asked) this.#askedAt = connection.now;
    connection.send(wanted ? request : { unsubscribe: this.name });
    this.#asked = asked;
    if (!request.video || !wanted) this.#endVideo(true);
  }

  /** Decode and draw a packet of video, then answer the server. @param {ArrayBuffer} bytes */
  decode(bytes) {
    this.#video ??= new Video({
      picture: (frame, head) => {
        const sides = [head.width || frame.displayWidth, head.height || frame.displayHeight];
        this.#show(frame, sides, { ...head, isVideo: true }, [0, 0, ...sides, ...sides]);
      },
      answer: (sequence) => this.connection.send({ got: sequence }),
      requestKey: () => this.connection.send({ key: this.name }),
      failed: () => {
        this.refusesVideo = true;
        setTimeout(() => {
          this.refusesVideo = false;
        }, RETRY_MS);
      },
    });
    this.#video.decode(bytes);
  }

  /** Draw a frame, then answer the server. @param {ArrayBuffer} bytes */
  async draw(bytes) {
    const head = new DataView(bytes);
    const sequence = head.getUint32(4);
    const [stamp, sent] = [head.getFloat64(8), head.getFloat64(16)];
    const connected = this.#connected;
    try {
      const begin = HEAD_BYTES + 14 + head.getUint16(HEAD_BYTES + 12);
      const id = new TextDecoder().decode(new Uint8Array(bytes.slice(HEAD_BYTES + 14, begin)));
      const origin = { exact: head.getBigUint64(HEAD_BYTES),
        number: head.getUint32(HEAD_BYTES + 8), id };
      const picture = await createImageBitmap(new Blob([new Uint8Array(bytes, begin)],
        { type: 'image/jpeg' }));
      const sides = [picture.width, picture.height];
      const place = Array.from({ length: 6 }, (_, index) => head.getUint32(PLACE + 4 * index));
      if (connected === this.#connected) {
        this.#show(picture, sides, { sequence, stamp, sent, origin }, place);
      }
      picture.close();
    } catch {
      // A broken picture is left out; the next one may be good.
    }
    if (connected !== this.#connected) return; // nobody waits for an answer
    this.connection.send({ got: sequence, busy: this.connection.lag.take() });
    this.look?.ask();
  }

  /** Draw a picture of a part of an image, unless a newer one is shown. */
  #show(picture, sides, { sequence, stamp, sent, isVideo = false, origin = null }, place) {
    if (sequence <= this.#drawn.sequence) return;
    const [width, height] = sides;
    if (this.canvas.width !== width) this.canvas.width = width;
    if (this.canvas.height !== height) this.canvas.height = height;
    this.context.drawImage(picture, 0, 0);
    this.#drawn = {
      sequence, stamp, origin, from: stamp > CLOCK_BEGINS ? stamp : sent, at: this.connection.now,
      period: 1 / (this.status?.sent?.rate || Infinity),
      wasOld: this.connection.now - sent > OLD,
      time: new Date().toLocaleTimeString(CLOCK), isVideo,
    };
    this.#ages.push(this.#drawn.at - this.#drawn.from);
    this.#ages.splice(0, this.#ages.length - AGES);
    this.canvas.hidden = false;
    this.view.show(place.slice(0, 4), place.slice(4));
    this.canvas.dispatchEvent(new CustomEvent('drawn', { detail: { sequence, stamp, sent, origin } }));
  }

  /** Return whether no picture has come for three periods, 1 to 2 s; longer for a slow camera. */
  #isLate(now, since) {
    const { period } = this.#drawn;
    return now - since > Math.max(1, 1.5 * period, Math.min(2, 3 * period));
  }

  /** Return whether the picture is old: pictures are missing, or nothing comes from the server. */
  #isFrozen(now, mood) {
    if (this.canvas.hidden || mood === 'paused') return false;
    if (mood !== 'live') return true;
    return Boolean(this.#asked && this.#drawn.period)
      && (this.#isLate(now, Math.max(this.#drawn.at, this.#askedAt)) || this.#drawn.wasOld);
  }

  /** Return the age of the picture in seconds: when it was drawn, or now if the next is late. */
  #currentAge(now) {
    if (this.#ages.length) {
      this.#ages.sort((one, other) => one - other);
      this.#age = this.#ages[this.#ages.length >> 1];
      this.#ages = [];
    }
    return this.#isLate(now, this.#drawn.at) ? now - this.#drawn.from : this.#age;
  }

  /** Show the facts. @param {'live' | 'paused' | 'stalled' | 'lost'} mood of the whole page. */
  show(mood) {
    const { connection, status } = this;
    const isFrozen = this.#isFrozen(connection.now, mood);
    const isHeld = mood === 'paused' && !this.canvas.hidden; // whatever happens to the camera
    const reason = this.refusal || (!isHeld && status.reason)
      || (isFrozen ? `No new picture since ${this.#drawn.time}` : '');
    const hasPicture = !this.canvas.hidden;
    this.element.classList.toggle('quiet', Boolean(reason));
    this.#part('.reason').hidden = !reason;
    this.#part('.reason').textContent = reason;
    this.link.title = reason;
    this.link.ariaLabel = `Show ${this.name}${reason && `: ${reason}`}`; // with the text in it
    this.#part('.wait').hidden = hasPicture || Boolean(reason);
    const { sent } = status;
    const seconds = hasPicture ? this.#currentAge(connection.now) : NaN;
    if (mood === 'live' && this.#asked && status.name) this.#history?.add(status, seconds);
    const facts = [
      ['Size', size(status)],
      ['Encoding', status.encoding],
      ['Rate', rate(status.rate)],
      ['Age', age(seconds)],
      ['Lost', status.frames ? number(status.lost) : ''],
      ['Restarted', Number.isFinite(status.restarted) && `${age(status.restarted)} ago`],
      ['Broken', status.broken ? `${number(status.broken)} left out` : ''],
      ['Shown', sent && [size(sent), (sent.slow ? `${sent.video} for a slow link` : sent.video)
        || (sent.passed_through ? 'unchanged' : `quality ${sent.quality}`),
      rate(sent.rate)].join(', ')],
      ['Zoom', hasPicture && `${Math.round(100 * this.view.scale * devicePixelRatio)} %`],
      ...this.origin,
      ['Overlay', status.overlay],
      ['Link', status.link && `${number(status.link)} Mbit/s`],
    ];
    this.#showFacts(facts.filter(([, text]) => text));
  }

  #showFacts(facts) {
    const list = this.#part('.facts');
    while (list.children.length > facts.length) list.lastElementChild.remove();
    facts.forEach(([name, text], place) => {
      const row = list.children[place]
        ?? list.appendChild(make('div', {}, make('dt'), make('dd')));
      row.dataset.fact = name.toLowerCase();
      row.firstElementChild.textContent = name;
      row.lastElementChild.textContent = text;
      row.lastElementChild.title = text;
    });
  }
}
