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

const HEAD = { key: 24, name: 25, width: 26, height: 28, number: 30, end: 34 };
const TESTED = { h264: 'avc1.42C01F', h265: 'hev1.1.6.L93.B0', av1: 'av01.0.04M.08' };
const TEST_MS = 2000;
const REQUEST_MS = 1000;
const MAX_FAILURES = 3;

/** Return the number of the topic, and whether it has video. @param {ArrayBuffer} bytes */
export function readTopic(bytes) {
  const topic = new DataView(bytes).getUint32(0);
  return { id: topic % 2 ** 31, isVideo: topic >= 2 ** 31 };
}

/** Return the names of the codecs that this browser decodes; none on an insecure page. */
export async function decodedCodecs() {
  if (!isSecureContext || !('VideoDecoder' in globalThis)) return [];
  const late = new Promise((done) => {
    setTimeout(() => done({ supported: false }), TEST_MS);
  });
  const found = await Promise.all(Object.entries(TESTED).map(async ([name, codec]) => {
    const test = VideoDecoder.isConfigSupported({ codec, optimizeForLatency: true });
    const { supported } = await Promise.race([test, late]).catch(() => ({ supported: false }));
    return supported ? name : '';
  }));
  return found.filter(Boolean);
}

/** Return the sentence about JPEG although there is video. @param {string} host */
export function explainJpeg(host) {
  if (isSecureContext) return 'This browser decodes no video here: pictures come as JPEG.';
  const { port } = location;
  return `Video needs a secure page: pictures come as JPEG. Open http://localhost:${port} after `
    + `ssh -L ${port}:localhost:${port} ${host}, or start img_viewer with certificate:=auto.`;
}

/** Decoder of the video of one topic. It begins with a key frame, also after an error. */
export class Video {
  #listener;
  #decoder = null;
  #configured = '';
  #number = -1;
  #heads = new Map(); // of the packets in the decoder, by sequence
  #requestedAt = -Infinity;
  #failures = 0; // since the last picture

  /**
   * Create a decoder that waits for a key frame.
   * @param {{ picture: (frame: VideoFrame, head: any) => void, failed: () => void,
   *   answer: (sequence: number) => void, requestKey: () => void }} listener
   */
  constructor(listener) {
    this.#listener = listener;
  }

  /** Decode a message with a packet; each is answered once. @param {ArrayBuffer} bytes */
  decode(bytes) {
    const view = new DataView(bytes);
    const nameEnd = HEAD.end + view.getUint8(HEAD.name);
    const head = {
      sequence: view.getUint32(4), stamp: view.getFloat64(8), sent: view.getFloat64(16),
      width: view.getUint16(HEAD.width), height: view.getUint16(HEAD.height),
    };
    const isKey = view.getUint8(HEAD.key) === 1;
    const number = view.getUint32(HEAD.number);
    const isNext = number === (this.#number + 1) % 2 ** 32;
    this.#number = number;
    try {
      if (isKey) {
        this.#configure(new TextDecoder().decode(bytes.slice(HEAD.end, nameEnd)), head);
      } else if (!isNext) {
        this.close();
      }
      if (this.#decoder) {
        this.#heads.set(head.sequence, head);
        this.#decoder.decode(new EncodedVideoChunk({
          type: isKey ? 'key' : 'delta', timestamp: head.sequence,
          data: new Uint8Array(bytes, nameEnd),
        }));
        return;
      }
    } catch {
      this.#fail();
    }
    this.#listener.answer(head.sequence);
    this.#requestKey();
  }

  /** Forget all packets, and answer them unless they came by an earlier connection. */
  close(answers = true) {
    if (this.#decoder && this.#decoder.state !== 'closed') this.#decoder.close();
    this.#decoder = null;
    this.#configured = '';
    const left = answers ? [...this.#heads.keys()] : [];
    this.#heads.clear();
    for (const sequence of left) this.#listener.answer(sequence);
  }

  #configure(codec, { width, height }) {
    const configuration = `${codec} ${width} ${height}`;
    if (this.#configured === configuration) return;
    this.close();
    const decoder = new VideoDecoder({
      output: (frame) => this.#show(decoder, frame),
      error: () => this.#fail(decoder),
    });
    decoder.configure({ codec, optimizeForLatency: true });
    this.#decoder = decoder;
    this.#configured = configuration;
  }

  #show(decoder, frame) {
    const head = this.#heads.get(frame.timestamp);
    if (decoder === this.#decoder && head) {
      this.#failures = 0;
      this.#heads.delete(frame.timestamp);
      this.#listener.picture(frame, head);
      this.#listener.answer(head.sequence);
    }
    frame.close();
  }

  #fail(decoder = this.#decoder) {
    if (decoder !== this.#decoder) return;
    this.close();
    this.#failures += 1;
    if (this.#failures >= MAX_FAILURES) this.#listener.failed();
    else this.#requestKey();
  }

  #requestKey() {
    const now = performance.now();
    if (now < this.#requestedAt + REQUEST_MS) return;
    this.#requestedAt = now;
    this.#listener.requestKey();
  }
}
