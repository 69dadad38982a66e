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

// What the page shows, as its address and the browser keep it.

import { make } from './page.js';

/** @import { Hello } from '../messages.js' */

const KEY = 'opencv_tools.viewer';
const KEPT = ['size', 'pin', 'hide', 'turn'];
const NAMES = ['search', 'beside', ...KEPT]; // in the address
const MOST = 4000; // characters
const TURN = /:([0-3])(f?)$/; // behind the name of a topic: quarters, and whether it is flipped

/** Return the settings in the address. */
export const readAddress = () => new URL(location.href).searchParams;

/**
 * Return the address of the page with other settings, which have one value, many or none.
 * @param {Record<string, unknown>} settings
 */
export function addressWith(settings) {
  const url = new URL(location.href);
  for (const [name, values] of Object.entries(settings)) {
    url.searchParams.delete(name);
    for (const value of [values].flat().filter(Boolean)) {
      url.searchParams.append(name, String(value));
    }
  }
  return url;
}

/** Keep settings in the address of the page. @param {Record<string, unknown>} settings */
export const keep = (settings) => history.replaceState(null, '', addressWith(settings));

/** Return the topic in the address, with the name that the node uses; '' for none. */
export function topicOfAddress() {
  const name = readAddress().get('topic') ?? '';
  return name && name.replace(/^\/?/, '/').replace(/(.)\/(compressed|ffmpeg|foxglove)$/, '$1');
}

/**
 * Copy a text. The clipboard API would need https.
 * @param {string} text
 * @returns {boolean} whether the browser allowed it.
 */
export function copyText(text) {
  const active = /** @type {HTMLElement} */ (document.activeElement);
  const field = make('textarea', { value: text, readOnly: true }); // no keyboard of a phone
  field.style.position = 'fixed';
  document.body.append(field);
  field.select();
  const isCopied = document.execCommand('copy');
  field.remove();
  active?.focus();
  return isCopied;
}

/** What the node says of itself, and what the page shows of it. */
export class State {
  /** @type {Hello} */
  node = { host: '', token: '', widths: [], download: false, video: 'never', control: false };
  selected = topicOfAddress(); // the topic that is shown alone; '' for all topics
  isPaused = false;
  /** @type {Record<string, number | boolean>} */
  fixed; // width, quality and rate of the address
  codecs; // that the browser decodes

  /** @param {string[]} codecs */
  constructor(codecs) {
    const given = readAddress();
    this.fixed = Object.fromEntries(['width', 'quality', 'rate']
      .filter((name) => given.has(name)).map((name) => [name, Number(given.get(name)) || 0]));
    if ('width' in this.fixed || 'quality' in this.fixed) this.fixed.fixed = true;
    this.codecs = this.isFixed ? [] : codecs;
  }

  get isFixed() {
    return Object.keys(this.fixed).length > 0;
  }
}

/** Return the values of some names, without the oldest ones if all of them are too long. */
function newest(values, names) {
  const pairs = [...values].filter(([name]) => names.includes(name));
  let left = MOST;
  const last = pairs.findLastIndex((pair) => {
    left -= `${new URLSearchParams([pair])}&`.length;
    return left < 0;
  });
  return new URLSearchParams(pairs.slice(last + 1));
}

/** Return what the browser keeps. */
function stored() {
  let text = '';
  try {
    text = localStorage.getItem(KEY) ?? '';
  } catch { /* the browser refuses it */ }
  return newest(new URLSearchParams(text), KEPT);
}

/** Return topics in their order, the pinned ones first, also those that are not published. */
const inOrder = (pins, topics) => [...new Set([...pins, ...topics.toSorted()])];

/** Which tiles are shown, in which order and how; kept in the address and in the browser. */
export class Arrangement {
  #values;

  /**
   * Read the arrangement of the address, or that of the last visit if the address has none.
   * @param {() => void} onChange
   */
  constructor(onChange) {
    this.onChange = onChange;
    const given = readAddress();
    const isGiven = KEPT.some((name) => given.has(name));
    this.#values = newest([...isGiven ? [] : stored(), ...given], NAMES);
    this.keep();
  }

  get(name) {
    return this.#values.get(name) ?? '';
  }

  has(name, topic) {
    return this.#values.has(name, topic);
  }

  /** Set the value of a name; '' removes all of its values. */
  set(name, value) {
    this.#change(name, () => [value].filter(Boolean));
  }

  /** Add a topic to the values of a name, or remove it. */
  toggle(name, topic) {
    const added = this.has(name, topic) ? [] : [topic];
    this.#change(name, (all) => [...all.filter((one) => one !== topic), ...added]);
  }

  /** Show a topic directly before another one: all topics up to it are pinned. */
  place(topic, before, topics) {
    this.#change('pin', (pins) => {
      const order = inOrder(pins, topics).filter((one) => one !== topic);
      order.splice(order.indexOf(before), 0, topic);
      const last = order.findLastIndex((one) => one === topic || pins.includes(one));
      return order.slice(0, last + 1);
    });
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
    const quarters = (flips ? 4 - turns : turns + 1) % 4;
    const flip = flips !== isFlipped ? 'f' : '';
    const added = quarters || flip ? [`${topic}:${quarters}${flip}`] : [];
    this.#change('turn',
      (all) => [...all.filter((one) => one.replace(TURN, '') !== topic), ...added]);
  }

  /** Return the topics that are shown, the pinned ones first. */
  list(topics) {
    const words = this.get('search').toLowerCase();
    return inOrder(this.#values.getAll('pin'), topics).filter((one) => topics.includes(one)
      && !this.has('hide', one) && one.toLowerCase().includes(words));
  }

  /** Change the values of a name, and nothing else of what the browser keeps. */
  #change(name, edit) {
    const edited = (values, names) => newest([...[...values].filter(([one]) => one !== name),
      ...edit(values.getAll(name)).map((value) => [name, value])], names);
    this.#values = edited(this.#values, NAMES);
    this.keep();
    try {
      localStorage.setItem(KEY, String(edited(stored(), KEPT)));
    } catch { /* the browser refuses it */ }
    this.onChange();
  }

  /** Write the arrangement into the address. */
  keep() {
    keep(Object.fromEntries(NAMES.map((name) => [name,
      name === 'beside' && !topicOfAddress() ? [] : this.#values.getAll(name)]))); // of one picture
  }
}
