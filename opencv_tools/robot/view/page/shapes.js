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

// Shapes of links: simple bodies and meshes; what is not shown is a box of wire.

const WIRE_SIZE = 0.1; // of the box of a shape without a size, in metres
const MAX_TRIANGLES = 5e6; // of all meshes of the page
const MAX_PIXELS = 1e8; // of all textures of the page
const MAX_REASON = 120; // characters of a library
// Bounds of meshes, counted in their files before anything is built from them.
const MAX_PARTS = 2e4; // objects of a mesh
const MAX_COUNT = 5e6; // polygons of a list
const MAX_STRIDE = 16; // numbers of an element of a source: a matrix
const MAX_ZEROS = 1e6; // elements that a file only counts
// Work that others determine is measured.
const SLICE_MS = 12; // without a pause
const MAX_SECONDS = 60; // of work on all meshes
const PICTURE = 1000; // pixels of a picture that a mesh fills
const MAX_PAINTED = 3e8; // pixels of such a picture that are painted, also those below others
const EDGE = 3; // pixels that a thin triangle paints in a row
const CHECKED = 30000; // corners in one piece
const PACKED_CHARS = 1 << 20; // of base64 in one piece: groups of four
const MAX_ALONE = 100; // words of a text of STL without an end
const GLB = 0x46546c67;
const JSON_CHUNK = 0x4e4f534a;

/** Why a mesh is not shown, as a sentence of the page. */
class MeshError extends Error {}

/**
 * Return a function that pauses after a slice of work, so that the page answers.
 * @returns {() => Promise<void>}
 */
export function pauses() {
  let begin = performance.now();
  return async () => {
    if (performance.now() - begin < SLICE_MS) return;
    await new Promise((resolve) => {
      const { port1, port2 } = new MessageChannel(); // a timer waits longer
      port1.onmessage = resolve;
      port2.postMessage(0);
    });
    begin = performance.now();
  };
}

function checkParts(parts) {
  if (!(parts <= MAX_PARTS)) throw new MeshError(`it has more than ${MAX_PARTS} parts`);
}

function checkCount(count, limit) {
  if (count > limit) throw new MeshError('it is damaged: it counts more than it contains');
}

/** Check a Collada file: a node may contain other nodes several times. */
function checkCollada(text) {
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
function checkGltf(bytes) {
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

/** Check a text of STL: the loader searches the end of each word anew, up to that of the file. */
function checkStl(text) {
  const open = new Set();
  let alone = 0;
  for (const [, end, word] of text.matchAll(/(end)?(solid|facet)/g)) {
    alone += Number(open.has(word) === !end);
    if (alone > MAX_ALONE) throw new MeshError('it is damaged: it has beginnings without an end');
    if (end) open.delete(word);
    else open.add(word);
  }
}

/** Check a Wavefront file: each object, group and material is a part. */
function checkObj(text) {
  checkParts(text.match(/^[ \t]*(?:o|g|usemtl)\s/gm)?.length ?? 0);
}

/** Loads each mesh once, and no other file than those that belong to it. */
export class Meshes {
  constructor(list) {
    this.list = list;
    this.loaded = new Map();
    this.triangles = this.pixels = this.seconds = 0;
    this.waiting = 0; // meshes that are not loaded yet
    this.last = Promise.resolve();
    this.rest = pauses();
  }

  /** Return a promise of an object for a mesh; it is rejected with the reason. */
  load(number) {
    if (!this.loaded.has(number)) {
      const found = this.last.then(() => this.read(number));
      const settle = () => {
        this.waiting -= 1;
        return this.rest();
      };
      this.waiting += 1;
      this.last = found.then(settle, settle);
      this.loaded.set(number, found);
    }
    return this.loaded.get(number);
  }

  async read(number) {
    const mesh = this.list[number];
    if (mesh.reason) throw new MeshError(mesh.reason);
    if (this.seconds > MAX_SECONDS) {
      throw new MeshError(`the meshes before it take more than ${MAX_SECONDS} seconds`);
    }
    const manager = new THREE.LoadingManager();
    const textures = new Map(); // numbers by address
    manager.setURLModifier((url) => {
      if (/^(blob|data):/.test(url)) return url;
      const part = mesh.parts[url.trim()];
      textures.set(this.address(part), part);
      return this.address(part);
    });
    manager.onError = (url) => { // other maps have no number
      const part = textures.get(url);
      if (part !== undefined || url.startsWith('blob:')) this.lose(mesh, part, 'it is damaged');
    };
    const loaded = new Promise((resolve) => {
      manager.onLoad = resolve;
    });
    manager.itemStart(mesh.uri);
    const bytes = await this.bytes(number);
    const begin = performance.now();
    const object = await this.parse(mesh, bytes, manager);
    this.seconds += (performance.now() - begin) / 1000;
    manager.itemEnd(mesh.uri);
    await loaded;
    let triangles = 0;
    const [geometries, materials] = [new Set(), new Set()];
    object.traverse(({ geometry, material, isInstancedMesh, count }) => {
      if (!geometry) return;
      geometries.add(geometry);
      triangles += (geometry.index ?? geometry.attributes.position).count / 3
        * (isInstancedMesh ? count : 1);
      for (const one of [material].flat()) materials.add(one);
    });
    if (!triangles) throw new MeshError('it has no triangles');
    if (this.triangles + triangles > MAX_TRIANGLES) {
      throw new MeshError(`all meshes have more than ${MAX_TRIANGLES} triangles`);
    }
    for (const { attributes } of geometries) {
      if (!attributes.position.array.every(Number.isFinite)) {
        throw new MeshError('it has points without place');
      }
    }
    if (!(await this.painted(object) <= MAX_PAINTED)) {
      throw new MeshError('its triangles are too many for their size: they would be painted over '
        + 'each other for a long time');
    }
    this.triangles += triangles;
    for (const material of materials) await this.checkTextures(mesh, material, textures);
    return object;
  }

  /** Return how many pixels a picture that an object fills has painted, with those of edges. */
  async painted(object) {
    const box = new THREE.Box3().setFromObject(object);
    const scale = PICTURE / box.getSize(new THREE.Vector3()).length();
    const parts = [];
    object.traverse((part) => part.geometry && parts.push(part));
    const [a, b, c] = [0, 1, 2].map(() => new THREE.Vector3());
    let pixels = 0;
    for (const { geometry: { index, attributes: { position } }, matrixWorld, ...part } of parts) {
      const length = scale * Math.cbrt(Math.abs(matrixWorld.determinant()));
      for (let at = 0; at + 2 < (index ?? position).count; at += 3) {
        [a, b, c].forEach((corner, number) => corner.fromBufferAttribute(
          position, index ? index.getX(at + number) : at + number));
        b.sub(a).multiplyScalar(length);
        c.sub(a).multiplyScalar(length);
        pixels += (EDGE * (b.length() + c.length()) + a.crossVectors(b, c).length() / 2)
          * (part.isInstancedMesh ? part.count : 1);
        if (at % CHECKED === 0) await this.rest();
      }
    }
    return pixels;
  }

  /** Remove the textures that are not there, and those above the limit of all. */
  async checkTextures(mesh, material, textures) {
    for (const [key, texture] of Object.entries(material)) {
      if (texture?.isTexture) {
        const { image } = texture;
        const pixels = (image?.width ?? 0) * (image?.height ?? 0);
        let reason = this.pixels + pixels > MAX_PIXELS
          ? `all textures have more than ${MAX_PIXELS} pixels` : '';
        if (pixels && !reason) {
          this.pixels += pixels;
          if (image.src && !await isWhole(image.src)) reason = 'it is damaged';
        }
        if (reason) this.lose(mesh, textures.get(image.getAttribute?.('src')), reason);
        if (reason || !pixels) material[key] = null;
      }
    }
  }

  /** Keep the reason why a texture of a mesh is not shown. */
  lose(mesh, number, reason) {
    const part = this.list[number];
    if (part) part.reason ||= reason;
    else mesh.parts[''] ??= this.list.push({ uri: 'texture in it', reason }) - 1;
  }

  /** Return the address of a file; an address without content if it is not shown. */
  address(number) {
    const { media_type: type, data, reason } = this.list[number]
      ?? { reason: 'it does not belong to a mesh' };
    if (reason) return 'data:,';
    return data === undefined ? `mesh/${number}` : `data:${type};base64,${data}`;
  }

  async bytes(number) {
    const { data, packed } = this.list[number];
    if (data !== undefined) {
      const bytes = [];
      for (let at = 0; at < data.length; at += PACKED_CHARS) {
        bytes.push(Uint8Array.from(atob(data.slice(at, at + PACKED_CHARS)),
          (one) => one.charCodeAt(0)));
        await this.rest();
      }
      const content = new Blob(bytes);
      if (!packed) return content.arrayBuffer();
      if (!window.DecompressionStream) {
        throw new MeshError('this browser does not unpack it (no DecompressionStream); use a '
          + 'newer browser');
      }
      return new Response(content.stream().pipeThrough(
        new DecompressionStream('gzip'))).arrayBuffer();
    }
    const answer = await fetch(this.address(number));
    if (!answer.ok) throw new MeshError('it cannot be read');
    return answer.arrayBuffer();
  }

  async parse({ kind, parts }, bytes, manager) {
    const text = (data = bytes) => new TextDecoder().decode(data);
    if (kind === 'stl') {
      const count = bytes.byteLength > 84 ? new DataView(bytes).getUint32(80, true) : 0;
      if (count * 50 > bytes.byteLength && !text().slice(0, 512).includes('solid')) {
        throw new MeshError('it is damaged');
      }
      if (bytes.byteLength !== 84 + count * 50) checkStl(text());
      return new THREE.Mesh(new THREE.STLLoader().parse(bytes));
    }
    if (kind === 'obj') {
      checkObj(text());
      const libraries = Object.values(parts).filter((number) => this.list[number].kind === 'mtl');
      const texts = await Promise.all(libraries.map(async (one) => text(await this.bytes(one))));
      return new THREE.OBJLoader(manager).setMaterials(
        new THREE.MTLLoader(manager).parse(texts.join('\n'), '')).parse(text());
    }
    if (kind === 'dae') {
      checkCollada(text());
      return collada(new THREE.ColladaLoader(manager).parse(text(), ''));
    }
    checkGltf(bytes);
    // RViz and Gazebo keep the coordinates of glTF.
    return (await new THREE.GLTFLoader(manager).parseAsync(bytes, '')).scene;
  }
}

/** Return whether a picture is complete; an image element shows a part of it without an error. */
async function isWhole(address) {
  try {
    (await createImageBitmap(await (await fetch(address)).blob())).close();
    return true;
  } catch {
    return false;
  }
}

/** Return the scene of a Collada file in metres. As in RViz, up_axis does not rotate it. */
function collada(file) {
  if (!file) throw new MeshError('it is damaged');
  file.scene.rotation.set(0, 0, 0);
  return new THREE.Group().add(file.scene);
}

const UPRIGHT = new THREE.Matrix4().makeRotationX(Math.PI / 2); // three.js has cylinders along y
const SIDES = window.frameElement ? 16 : 32; // of round shapes; fewer beside cameras
const UNIT = { box: new THREE.BoxGeometry(), sphere: new THREE.SphereGeometry(1, SIDES, SIDES / 2),
  cylinder: new THREE.CylinderGeometry(1, 1, 1, SIDES).applyMatrix4(UPRIGHT),
  cone: new THREE.CylinderGeometry(0, 1, 1, SIDES).applyMatrix4(UPRIGHT),
  plane: new THREE.PlaneGeometry() };

const EDGES = new THREE.EdgesGeometry(new THREE.BoxGeometry(WIRE_SIZE, WIRE_SIZE, WIRE_SIZE));

/** Return a simple body. @type {(geometry: any, material: object) => any} */
function bodyOf({ kind, size, radii, radius, length, normal }, material) {
  if (kind === 'capsule') {
    return new THREE.Mesh(new THREE.CapsuleGeometry(radius, length, SIDES / 4, SIDES).applyMatrix4(UPRIGHT),
      material);
  }
  const body = new THREE.Mesh(UNIT[kind === 'ellipsoid' ? 'sphere' : kind], material);
  body.scale.set(...(radii ?? size ?? [radius, radius, length ?? radius]), 1);
  if (normal) {
    body.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1),
      new THREE.Vector3(...normal).normalize());
  }
  return body;
}

/** Return a box of wire instead of a shape; `userData.reason` says why. */
function wireBox(reason, material) {
  const box = new THREE.LineSegments(EDGES, material);
  box.userData.reason = reason;
  return box;
}

/**
 * Fill a group with a shape.
 * @param {{ add: (object: object) => unknown }} group
 * @param {{ geometry: Record<string, any> }} shape
 * @param {{ material: object, adopt: ((found: object) => object) | false, wire: object,
 *   meshes: Meshes, onLoaded: () => void }} context adopt returns the materials of a mesh as the
 *   robot shows them; without it, the mesh has `material`. wire is that of a box of wire. onLoaded
 *   is called when a mesh has been loaded, or has failed.
 */
export function fillShape(group, { geometry }, { material, adopt, wire, meshes, onLoaded }) {
  if (geometry.kind === 'none') {
    group.add(wireBox(geometry.reason, wire));
  } else if (geometry.kind !== 'mesh') {
    group.add(bodyOf(geometry, material));
  } else {
    const mesh = meshes.list[geometry.mesh];
    meshes.load(geometry.mesh).then((object) => {
      const copy = object.clone();
      copy.traverse((part) => {
        if (!part.isMesh) return;
        part.material = adopt && hasColours(part.material) ? adopt(part.material) : material;
      });
      const scaled = new THREE.Group().add(copy);
      scaled.scale.set(...geometry.scale);
      group.add(scaled);
    }).catch((err) => {
      mesh.reason ||= err instanceof MeshError ? err.message
        : `it is damaged (${err.message.slice(0, MAX_REASON)})`;
      group.add(wireBox(`${mesh.uri}: ${mesh.reason}`, wire));
    }).finally(onLoaded);
  }
}

const hasColours = (material) => [material].flat().some(
  (one) => one.map || (one.color && one.color.getHex() !== 0xffffff && one.name));
