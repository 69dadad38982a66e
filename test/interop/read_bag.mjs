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

// Read a bag with Foxglove's reader: node read_bag.mjs FOLDER_OF_NODE_MODULES BAG indexed|streaming.
// Each message is a line of JSON: topic, log time, publish time, sequence, SHA-256 of the data.

import { createHash } from 'node:crypto';
import { open } from 'node:fs/promises';
import { createRequire } from 'node:module';

const [folder, path, way] = process.argv.slice(2);
const { McapIndexedReader, McapStreamReader } = createRequire(`${folder}/`)('@mcap/core');
const channels = new Map();

function print(message) {
  const digest = createHash('sha256').update(message.data).digest('hex');
  console.log(JSON.stringify([
    channels.get(message.channelId).topic, `${message.logTime}`, `${message.publishTime}`,
    message.sequence, digest]));
}

const file = await open(path);
const { size } = await file.stat();
async function read(offset, length) {
  const buffer = new Uint8Array(Number(length));
  await file.read(buffer, 0, buffer.length, Number(offset));
  return buffer;
}

if (way === 'indexed') {
  const reader = await McapIndexedReader.Initialize({
    readable: { size: async () => BigInt(size), read } });
  for (const [id, channel] of reader.channelsById) channels.set(id, channel);
  for await (const message of reader.readMessages()) print(message);
} else {
  const reader = new McapStreamReader({ includeChunks: false });
  reader.append(await read(0, size));
  for (let record; (record = reader.nextRecord());) {
    if (record.type === 'Channel') channels.set(record.id, record);
    if (record.type === 'Message') print(record);
  }
  if (!reader.done()) console.log(JSON.stringify('the end is missing'));
}
await file.close();
