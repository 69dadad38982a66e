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

// The drawing: one camera, one or two views, names. It draws only after a change.

export const MAX_NAMES = 200; // in one view
const GAP = 5; // pixels between a point and its name
const FILLED = 0.94; // part of a view that the robot has
const LONG_MS = 50; // a picture that takes longer is followed by a pause of the same length
const REST = 4; // pauses for the time taken, so that work has a fifth of the time at most
const FRAME_MS = 25; // until the browser draws again; longer if the graphics are slow
const MAX_COST_MS = 1000; // it was longer if nobody looked meanwhile
const FIRST_DRAWS = 10; // which prepare the graphics
const MOVED_PIXELS = 5; // a click with less movement chooses a link
const KEPT_MS = 10000; // the browser has read the file by then

export class Stage {
  constructor(box, listener) {
    this.box = box;
    this.listener = listener;
    this.names = listener.names;
    this.draws = this.cost = this.usual = this.searchMs = 0;
    this.isBeside = Boolean(window.frameElement); // cameras, which go first
    this.views = ['urdf'];
    this.wanted = false;
    this.scene = new THREE.Scene();
    this.light = new THREE.DirectionalLight(0xffffff, 2);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x777777, 1.6), this.light);
    this.camera = new THREE.PerspectiveCamera(40, 1, 0.01, 1000);
    this.camera.up.set(0, 0, 1);
    this.renderer = new THREE.WebGLRenderer({ antialias: !this.isBeside });
    this.renderer.setPixelRatio(this.isBeside ? 2 : Math.min(devicePixelRatio, 2));
    const canvas = this.renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute('role', 'img');
    canvas.setAttribute('aria-label', 'Robot');
    box.prepend(canvas);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.addEventListener('change', () => {
      this.isMoved = true;
      this.request();
    });
    this.controls.listenToKeyEvents(canvas);
    let pressed = [0, 0];
    canvas.addEventListener('pointerdown', (event) => {
      pressed = [event.clientX, event.clientY];
    });
    canvas.addEventListener('pointerup', (event) => {
      const distance = Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]);
      const found = distance < MOVED_PIXELS && this.pick(event);
      if (found) listener.onChoose(found);
    });
    canvas.addEventListener('pointermove', ({ offsetX, offsetY, buttons }) => {
      this.pointer = buttons ? undefined : { offsetX, offsetY };
      this.searching ??= setTimeout(() => this.search(), this.searchMs * REST);
    });
    canvas.addEventListener('pointerleave', () => {
      this.pointer = undefined;
      listener.onPoint();
    });
    new ResizeObserver(() => this.resize()).observe(box);
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.request());
    this.resize();
  }

  resize() {
    this.renderer.setSize(this.box.clientWidth, this.box.clientHeight);
    this.request();
    this.listener.onResize();
  }

  /** Draw once before the next picture of the screen. */
  request() {
    if (this.wanted) return;
    this.wanted = true;
    const draw = () => requestAnimationFrame(() => this.draw());
    const pauses = this.isBeside ? REST : Number(this.cost >= LONG_MS);
    setTimeout(draw, pauses * this.cost); // the page answers meanwhile
  }

  /** Return the views with their rectangles in pixels. */
  rectangles() {
    const [width, height] = [this.box.clientWidth, this.box.clientHeight];
    const isTall = height > width;
    this.box.dataset.tall = isTall;
    return this.views.map((view, number) => {
      const part = number / this.views.length;
      return isTall
        ? { view, left: 0, top: part * height, width, height: height / this.views.length }
        : { view, left: part * width, top: 0, width: width / this.views.length, height };
    });
  }

  draw() {
    const begin = performance.now();
    this.listener.beforeDraw();
    this.wanted = false;
    this.draws += 1;
    const { renderer, camera, scene } = this;
    this.light.position.copy(camera.position);
    scene.background = new THREE.Color(getComputedStyle(this.box).backgroundColor);
    renderer.setScissorTest(true);
    const labels = [];
    for (const one of this.rectangles()) {
      const bottom = this.box.clientHeight - one.top - one.height;
      renderer.setViewport(one.left, bottom, one.width, one.height);
      renderer.setScissor(one.left, bottom, one.width, one.height);
      camera.aspect = one.width / Math.max(one.height, 1);
      camera.updateProjectionMatrix();
      labels.push(...this.listener.beforeView(one.view).slice(0, MAX_NAMES).map(
        (label) => this.place(label, one)));
      renderer.render(scene, camera);
    }
    this.showNames(labels.filter(Boolean));
    this.cost = performance.now() - begin;
    if (this.isBeside) requestAnimationFrame(() => this.slow(performance.now() - begin));
  }

  /** Take the time until the browser draws again, and draw less fine if it is usually long. */
  slow(milliseconds) {
    this.cost = Math.min(milliseconds, MAX_COST_MS);
    this.usual += (this.cost - this.usual) / FIRST_DRAWS;
    const isFine = this.renderer.getPixelRatio() > 1;
    if (!isFine || this.draws < FIRST_DRAWS || this.usual < FRAME_MS) return;
    this.renderer.setPixelRatio(1);
    this.request(); // as the canvas is empty now
  }

  /** Return the point of a name on the page; nothing if the camera does not see it. */
  place({ text, point }, view) {
    const seen = point.clone().project(this.camera);
    if (Math.abs(seen.x) > 1 || Math.abs(seen.y) > 1 || Math.abs(seen.z) > 1) return undefined;
    return { text, view, x: view.left + (seen.x + 1) / 2 * view.width,
      y: view.top + (1 - seen.y) / 2 * view.height };
  }

  /** Show names beside their points, the first ones first; no name is over another one. */
  showNames(labels) {
    while (this.names.childElementCount > labels.length) this.names.lastChild.remove();
    while (this.names.childElementCount < labels.length) {
      this.names.append(document.createElement('span'));
    }
    const elements = [...this.names.children];
    labels.forEach(({ text }, number) => {
      if (elements[number].textContent !== text) elements[number].textContent = text;
    });
    const taken = (labels.length ? [...this.box.querySelectorAll('.caption')] : []).map(
      (one) => [one.offsetLeft, one.offsetTop, one.offsetWidth, one.offsetHeight]);
    /** @type {(place: number[]) => boolean} */
    const isFree = ([left, top, width, height]) => taken.every(([x, y, w, h]) => (
      left >= x + w || x >= left + width || top >= y + h || y >= top + height));
    labels.forEach(({ x, y, view }, number) => {
      const { style, offsetWidth: width, offsetHeight: height } = elements[number];
      const found = [y + GAP, y - GAP - height].flatMap((top) => (
        [x + GAP, x - GAP - width].map((left) => [left, top, width, height]))).find((one) => (
        one[0] >= view.left && one[0] + width <= view.left + view.width
        && one[1] >= view.top && one[1] + height <= view.top + view.height && isFree(one)));
      style.visibility = found ? 'visible' : 'hidden';
      if (!found) return;
      taken.push(found);
      style.transform = `translate(${found[0].toFixed(1)}px, ${found[1].toFixed(1)}px)`;
    });
  }

  /** Search the link below the pointer. */
  search() {
    const begin = performance.now();
    this.listener.onPoint(this.pointer && this.pick(this.pointer));
    this.searching = undefined;
    this.searchMs = performance.now() - begin;
  }

  /** Return the link at a place of the picture, and its robot; nothing if there is none. */
  pick({ offsetX, offsetY }) {
    const one = this.rectangles().find(({ left, top, width, height }) => (
      offsetX >= left && offsetX < left + width && offsetY >= top && offsetY < top + height));
    if (!one) return undefined;
    this.listener.beforeView(one.view);
    this.camera.aspect = one.width / one.height;
    this.camera.updateProjectionMatrix();
    const ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2((offsetX - one.left) / one.width * 2 - 1,
      1 - (offsetY - one.top) / one.height * 2), this.camera);
    for (const { object } of ray.intersectObject(this.scene, true)) {
      let owner = object;
      let isShown = true;
      while (owner && owner.userData.link === undefined) {
        isShown &&= owner.visible;
        owner = owner.parent;
      }
      if (owner && isShown && owner.visible && owner.parent.parent.visible) return owner.userData;
    }
    return undefined;
  }

  /** Look at points from the front, the left and above, so near that they fill a view. */
  fit(points) {
    const { camera, controls } = this;
    const [{ width, height }] = this.rectangles();
    const back = new THREE.Vector3(1, -1, 0.6).normalize();
    const right = new THREE.Vector3(1, 1, 0).normalize();
    const top = back.clone().cross(right);
    const tangent = FILLED * Math.tan(camera.fov * Math.PI / 360);
    const most = (value) => points.reduce((found, one) => Math.max(found, value(one)), -Infinity);
    // Each side of the view is a plane that the points are inside of.
    const sides = [[right, tangent * Math.max(width / Math.max(height, 1), 0.1)], [top, tangent]].map(
      ([axis, slope]) => [axis, ...[1, -1].map(
        (sign) => most((point) => sign * point.dot(axis) + slope * point.dot(back))), slope]);
    const middle = (most((one) => one.dot(back)) - most((one) => -one.dot(back))) / 2;
    const distance = Math.max(0.03, ...sides.map(
      ([, one, other, slope]) => (one + other) / 2 / slope - middle));
    controls.target.copy(back).multiplyScalar(middle);
    for (const [axis, one, other] of sides) {
      const place = (one - other) / 2;
      const seen = (sign) => most((point) => (
        sign * (point.dot(axis) - place) / (distance + middle - point.dot(back))));
      controls.target.addScaledVector(axis, place + (seen(1) - seen(-1)) / 2 * distance);
    }
    camera.position.copy(controls.target).addScaledVector(back, distance);
    camera.near = distance / 1000;
    camera.far = distance * 100;
    controls.update();
    this.isMoved = false;
    this.request();
  }

  /** Save the picture as a file. */
  save(name) {
    this.draw();
    // The picture has to be taken before the browser shows it and clears the buffer.
    this.renderer.domElement.toBlob((blob) => {
      const link = document.createElement('a');
      link.href = URL.createObjectURL(blob);
      link.download = name;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), KEPT_MS);
    });
  }
}
