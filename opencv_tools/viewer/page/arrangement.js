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

const KEY = 'opencv_tools.viewer';
const NAMES = ['search', 'size', 'pin', 'hide', 'turn', 'beside'];
const PASSING = ['search', 'beside']; // only in the address
const TURN = /:([0-3])(f?)$/; // behind the name of a topic: quarters, and whether it is flipped

/** Which tiles are shown, in which order and how; kept in the address and in the browser. */
export class Arrangement {
  #values = new URLSearchParams();

  /** Read the arrangement of the address, or that of the last visit if the address has none. */
  constructor() {
    const { searchParams } = new URL(location);
    const isGiven = NAMES.some((name) => !PASSING.includes(name) && searchParams.has(name));
    let kept = '';
    try { kept = localStorage.getItem(KEY) ?? ''; } catch { /* the browser refuses it */ }
    for (const name of NAMES) {
      const found = isGiven || PASSING.includes(name) ? searchParams : new URLSearchParams(kept);
      for (const value of found.getAll(name)) this.#values.append(name, value);
    }
    this.keep();
  }

  get(name) {
    return this.#values.get(name) ?? '';
  }

  has(name, topic) {
    return this.#values.has(name, topic);
  }

  /** Set the values of a name. */
  set(name, ...values) {
    this.#values.delete(name);
    for (const value of values.filter(Boolean)) this.#values.append(name, value);
    this.keep();
  }

  /** Add a topic to the values of a name, or remove it; it comes before another one. */
  toggle(name, topic, before) {
    const isNew = before || !this.has(name, topic);
    const others = this.#values.getAll(name).filter((one) => one !== topic);
    const place = others.indexOf(before);
    if (isNew) others.splice(place < 0 ? others.length : place, 0, topic);
    this.set(name, ...others);
  }

  /** Return the quarters by which a topic is turned, and whether it is flipped before. */
  turned(topic) {
    const text = this.#values.getAll('turn').find((one) => one.replace(TURN, '') === topic);
    const [, turns = '0', flip = ''] = TURN.exec(text) ?? [];
    return { turns: Number(turns), isFlipped: flip === 'f' };
  }

  /** Turn a topic by a quarter, or flip it as it is shown. */
  turn(topic, flips = false) {
    const { turns, isFlipped } = this.turned(topic);
    const others = this.#values.getAll('turn').filter((one) => one.replace(TURN, '') !== topic);
    const quarters = (flips ? 4 - turns : turns + 1) % 4;
    const isKept = quarters || flips !== isFlipped;
    this.set('turn', ...others, isKept && `${topic}:${quarters}${flips !== isFlipped ? 'f' : ''}`);
  }

  /** Return the topics that are shown, the pinned ones first. */
  list(topics) {
    const pins = this.#values.getAll('pin');
    const place = (topic) => (pins.includes(topic) ? pins.indexOf(topic) : pins.length);
    const words = this.get('search').toLowerCase();
    return topics.filter((one) => !this.has('hide', one) && one.toLowerCase().includes(words))
      .sort((one, other) => place(one) - place(other) || (one < other ? -1 : 1));
  }

  /** Write the arrangement into the address and into the browser. */
  keep() {
    const url = new URL(location);
    for (const name of NAMES) url.searchParams.delete(name);
    for (const [name, value] of this.#values) url.searchParams.append(name, value);
    history.replaceState(null, '', url);
    const kept = [...this.#values].filter(([name]) => !PASSING.includes(name));
    try { localStorage.setItem(KEY, new URLSearchParams(kept)); } catch { /* the browser refuses it */ }
  }
}
