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

/**
 * @import { Request, RobotRequest, SessionRequest } from '../messages.js'
 * @typedef Listener what uses the messages of the server.
 * @property {(hello: any) => void} connected
 * @property {(sentence: string) => void} disconnected
 * @property {(message: any) => void} received
 * @property {(bytes: ArrayBuffer) => void} [frame]
 */

const FIRST_RETRY_MS = 500;
const LAST_RETRY_MS = 5000;
const PING_MS = 1000;
const SILENCE_MS = 12000; // a large picture on a slow link takes seconds
const ANSWER_MS = 3000;
const CLOCK_SAMPLES = 40;
const FIRST_PINGS = 4;
const LAG_MS = 50;
const LEAST_LAG = 0.05; // seconds
const STALLED_SECONDS = 2; // two pings without an answer

/** Return the time of the page in seconds; changes of the system clock have no effect. */
const now = () => (performance.timeOrigin + performance.now()) / 1000;

/** Difference between the clocks of server and page, from the quickest of the last pings. */
class Clock {
  samples = [];

  add(sent, received, server) {
    this.samples.push({ roundTrip: received - sent, offset: server - (sent + received) / 2 });
    this.samples.splice(0, this.samples.length - CLOCK_SAMPLES);
  }

  get offset() {
    return this.samples.reduce((best, one) => (one.roundTrip < best.roundTrip ? one : best),
      this.samples[0] ?? { offset: 0 }).offset;
  }
}

/** Time that the page was busy with other work, such as a robot. */
export class Lag {
  #last = performance.now();
  #total = 0;
  onLag = (/** @type {number} */ _seconds) => {}; // called after each delay

  constructor() {
    setInterval(() => {
      const time = performance.now();
      const late = document.hidden ? 0 : (time - this.#last - LAG_MS) / 1000;
      this.#last = time;
      if (late < LEAST_LAG) return;
      this.#total += late;
      this.onLag(late);
    }, LAG_MS);
  }

  /** Return the seconds since the last call. */
  take() {
    const total = this.#total + Math.max(0, (performance.now() - this.#last - LAG_MS) / 1000);
    this.#total = 0;
    return Math.min(3600, total);
  }
}

/** WebSocket of the page, which connects again by itself while somebody looks at the page. */
export class Connection {
  #listener;
  #path;
  #socket = null;
  #clock = new Clock();
  #retryMs = FIRST_RETRY_MS;
  #retry = 0;
  #heard = 0;
  lag = new Lag();
  #isGreeted = false; // by the server, so that the page may ask

  /**
   * @param {Listener} listener
   * @param {string} path of the WebSocket.
   */
  constructor(listener, path = '/ws') {
    this.#listener = listener;
    this.#path = path;
    setInterval(() => this.#check(SILENCE_MS), PING_MS);
    document.addEventListener('visibilitychange', () => this.#look());
    addEventListener('online', () => this.#look());
    this.#open();
  }

  get isOpen() {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  /** Time of the server in seconds. */
  get now() {
    return now() + this.#clock.offset;
  }

  /** Whether the server sends messages: 'live', 'stalled' or 'lost'. */
  get mood() {
    if (!this.#isGreeted) return 'lost';
    return this.#silence > STALLED_SECONDS ? 'stalled' : 'live';
  }

  /** Seconds since the last message of the server. */
  get #silence() {
    return now() - this.#heard;
  }

  /** Send a message. @type {(message: Request | SessionRequest | RobotRequest) => void} */
  send = (message) => {
    if (this.isOpen) this.#socket.send(JSON.stringify(message));
  };

  #open() {
    clearTimeout(this.#retry);
    this.#heard = now();
    const scheme = location.protocol === 'https:' ? 'wss:' : 'ws:';
    const socket = new WebSocket(`${scheme}//${location.host}${this.#path}`);
    socket.binaryType = 'arraybuffer';
    socket.onmessage = (event) => this.#receive(event.data);
    socket.onclose = (event) => this.#close(event.reason);
    this.#socket = socket;
  }

  #receive(data) {
    this.#heard = now();
    if (data instanceof ArrayBuffer) {
      this.#listener.frame?.(data);
      return;
    }
    const message = JSON.parse(data);
    if (message.hello) {
      this.#retryMs = FIRST_RETRY_MS;
      this.#clock = new Clock();
      this.#ping();
      this.#isGreeted = true;
      this.#listener.connected(message.hello);
    } else if (message.pong) {
      this.#clock.add(message.pong, now(), message.now);
      if (this.#clock.samples.length < FIRST_PINGS) this.#ping();
    } else {
      this.#listener.received(message);
    }
  }

  #ping() {
    this.send({ ping: now() });
  }

  #close(sentence = '') {
    this.#socket.onmessage = this.#socket.onclose = null;
    this.#socket.close();
    this.#socket = null;
    this.#isGreeted = false;
    this.#listener.disconnected(sentence);
    if (document.hidden) return;
    this.#retry = setTimeout(() => this.#open(), this.#retryMs);
    this.#retryMs = Math.min(2 * this.#retryMs, LAST_RETRY_MS);
    this.#explain();
  }

  /** Ask why the server refuses the WebSocket, which the browser does not tell. */
  async #explain() {
    try {
      const signal = AbortSignal.timeout(ANSWER_MS);
      const answer = await fetch('/topics', { cache: 'no-store', signal });
      if (!answer.ok && !this.isOpen) this.#listener.disconnected((await answer.text()).trim());
    } catch {
      // The server does not answer, as the page says already.
    }
  }

  #check(silenceMs) {
    if (!this.#socket || document.hidden) return;
    if (this.#silence > silenceMs / 1000) this.#close();
    else this.#ping();
  }

  /** Connect at once when the page is shown again; a socket may have died meanwhile. */
  #look() {
    if (document.hidden) return;
    this.#retryMs = FIRST_RETRY_MS;
    if (!this.#socket) {
      this.#open();
    } else if (this.isOpen) {
      this.#heard = now();
      this.#ping();
      setTimeout(() => this.#check(ANSWER_MS / 2), ANSWER_MS);
    }
  }
}
