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

// Bounds of meshes, counted in their files before anything is built from them.

const MAX_PARTS = 2e4; // objects of a mesh
const MAX_COUNT = 5e6; // polygons of a list
const MAX_STRIDE = 16; // numbers of an element of a source: a matrix
const MAX_ZEROS = 1e6; // elements that a file only counts
const GLB = 0x46546c67;
const JSON_CHUNK = 0x4e4f534a;

/** Why a mesh is not shown, as a sentence of the page. */
export class MeshError extends Error {}

function checkParts(parts) {
  if (!(parts <= MAX_PARTS)) throw new MeshError(`it has more than ${MAX_PARTS} parts`);
}

function checkCount(count, limit) {
  if (count > limit) throw new MeshError('it is damaged: it counts more than it contains');
}

/** Check a Collada file: a node may contain other nodes several times. */
export function checkCollada(text) {
  const file = new DOMParser().parseFromString(text, 'application/xml');
  const nodes = new Map();
  for (const node of file.querySelectorAll('node[id]')) {
    nodes.set(node.id, [...(nodes.get(node.id) ?? []), node]);
  }
  const counts = new Map();
  const sum = (found) => found.reduce((total, one) => total + count(one), 0);
  const count = (node) => {
    if (!counts.has(node)) {
      counts.set(node, Infinity); // of a node that contains itself
      const inside = [...node.children].map((one) => (one.nodeName === 'node' ? count(one)
        : one.nodeName === 'instance_node'
          ? sum(nodes.get((one.getAttribute('url') ?? '').slice(1)) ?? [])
          : Number(one.nodeName.startsWith('instance_'))));
      counts.set(node, inside.reduce((total, one) => total + one, 1));
    }
    return counts.get(node);
  };
  checkParts(sum([...file.querySelectorAll('visual_scene > node')]));
  for (const one of file.querySelectorAll('accessor[stride]')) {
    checkCount(parseInt(one.getAttribute('stride'), 10), MAX_STRIDE);
  }
  for (const one of file.querySelectorAll('polylist, polygons')) {
    checkCount(parseInt(one.getAttribute('count'), 10), MAX_COUNT);
  }
  for (const one of file.querySelectorAll('vcount')) {
    const texts = [...one.parentElement.children].filter(({ nodeName }) => /^[pv]$/.test(nodeName));
    checkCount(one.textContent.trim().split(/\s+/).reduce((total, text) => total + Number(text), 0),
      Math.max(0, ...texts.map(({ textContent }) => (textContent.length + 1) / 2)));
  }
}

/** Check a binary glTF file: several nodes may have the same mesh. */
export function checkGltf(bytes) {
  const view = new DataView(bytes);
  if (view.getUint32(0, true) !== GLB) throw new MeshError('it is damaged');
  for (let at = 12; at < view.byteLength;) {
    const length = view.getUint32(at, true);
    if (view.getUint32(at + 4, true) === JSON_CHUNK) {
      const { nodes = [], meshes = [], accessors = [] } = JSON.parse(
        new TextDecoder().decode(new Uint8Array(bytes, at + 8, length)));
      checkParts(nodes.reduce(
        (total, { mesh }) => total + 1 + (meshes[mesh]?.primitives.length ?? 0), 0));
      checkCount(accessors.reduce((total, { count, bufferView, sparse }) => (
        total + (bufferView === undefined || sparse ? count : 0)), 0), MAX_ZEROS);
    }
    at += 8 + length;
  }
}

/** Check a Wavefront file: each object, group and material is a part. */
export function checkObj(text) {
  checkParts(text.match(/^\s*(?:o|g|usemtl)\s/gm)?.length ?? 0);
}
