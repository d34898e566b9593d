// Wires everything together.

/** Longest time that a picture may take while the camera moves, milliseconds; it gets smaller instead. */
const PATIENCE = 80;
/** A pixel shows the same surface if its depth changes by less than this share of it. */
const SAME_DEPTH = 0.01;
/** How long it takes to fly to a camera, milliseconds. */
const FLIGHT = 400;

class Viewer {
  constructor(model) {
    const { about } = model;
    Object.assign(this, { about, model });
    this.canvas = byId('picture');
    this.overlay = byId('overlay');
    this.renderer = model.renderer(this.canvas);
    this.shown = { layer: 'uncertainty', split: 0.5, hidesUnseen: false, range: about.range, depths: [0, 1] };
    this.shown.threshold = about.prior;
    this.uncrop();
    this.current = 0;
    this.frusta = false;
    [this.isMeasuring, this.ends] = [false, []];
    this.shrink = 1;
    this.listenToContext();
    const first = about.cameras[0] ?? this.someCamera();
    this.camera = new Orbit(first, about.up, this.model.size);
    this.jump(0);
  }

  /** Says if the browser takes the graphics away, as after sleep, and draws again when it gives them back. */
  listenToContext() {
    const status = byId('status');
    this.canvas.addEventListener('webglcontextlost', (event) => {
      // Without this it is never given back.
      event.preventDefault();
      this.isLost = true;
      status.textContent = 'The browser took the graphics context away. The picture returns when it gives it back. ';
      const reload = status.appendChild(document.createElement('button'));
      reload.textContent = 'Reload the page';
      // Not a drag of the picture.
      reload.onpointerdown = (press) => press.stopPropagation();
      reload.onclick = () => location.reload();
      status.hidden = false;
    });
    this.canvas.addEventListener('webglcontextrestored', () => {
      try {
        this.renderer = this.model.renderer(this.canvas);
        [this.isLost, this.whole, status.hidden] = [false, null, true];
        this.changed();
      } catch (error) {
        status.prepend(`${error.message} `);
      }
    });
  }

  /** A view of the whole box, if there are no cameras. */
  someCamera() {
    const [right, up, back] = [[1, 1, 0], [-0.6, 0.6, 2], [1, -1, 0.6]].map(unit);
    const position = add(this.model.anchor, scale(back, 1.6 * this.model.size));
    const axes = [...right, ...up, ...back];
    return { position, axes, focal: [500, 500], center: [256, 256], resolution: [512, 512] };
  }

  /** Goes to training camera k. */
  jump(k) {
    const { cameras } = this.about;
    if (cameras.length === 0) return;
    cancelAnimationFrame(this.flight);
    this.current = (k + cameras.length) % cameras.length;
    const camera = cameras[this.current];
    this.camera.jump(camera, this.model.size);
    const { resolution, center } = this.camera;
    const hit = this.read(center[0], center[1]);
    if (hit) this.camera.distance = hit.depth;
    const number = camera.isPlanned ? `plan ${camera.index + 1}` : camera.index;
    const name = `${number}: ${camera.name} (${resolution.join(' × ')})`;
    const lens = camera.isDistorted ? ', drawn without the distortion of its lens' : '';
    say('camera-name', name + lens);
    this.fitDepths();
    this.changed();
  }

  /** Flies to training camera k. */
  fly(k) {
    const { position, axes } = this.camera;
    this.jump(k);
    const goal = { position: this.camera.position, axes: this.camera.axes };
    const start = performance.now();
    const step = () => {
      const part = Math.min((performance.now() - start) / FLIGHT, 1);
      Object.assign(this.camera, between({ position, axes }, goal, part * part * (3 - 2 * part)));
      if (part < 1) this.flight = requestAnimationFrame(step);
      else Object.assign(this.camera, goal);
      this.changed(part < 1);
    };
    step();
  }

  /** Looks at all of the model's box, or at the middle of contracted space, from the direction of now. */
  frame() {
    const { focal, resolution } = this.camera;
    const distance = (this.model.framed * Math.max(...focal)) / Math.min(...resolution);
    this.camera.look(this.model.anchor, column(this.camera.axes, 2), distance);
    this.moved();
  }

  /** Looks at what is under an image point, and turns about it from now on. */
  focus(x, y) {
    const found = this.read(x, y);
    if (!found) return;
    const back = sub(this.camera.position, found.position);
    this.camera.look(found.position, unit(back), norm(back));
    this.moved();
  }

  /** Which training camera's frustum is near to a point of the page; null if none is, or if they are not shown. */
  pick(event, near) {
    if (!this.frusta) return null;
    const [width, height] = this.fixed ?? this.size();
    const scale = width / this.canvas.clientWidth;
    return picked(this.allFrusta(width, height), this.canvasPoint(event), near * scale);
  }

  /** Chooses what is under an image point as an end of a length; after two, begins anew. */
  mark(x, y) {
    const found = this.read(x, y);
    if (!found) return;
    this.ends = [...(this.ends.length < 2 ? this.ends : []), endAt(this.model, found)];
    say('length', describeEnds(this.model, this.ends));
    this.changed();
  }

  /**
   * Moves a face of the crop box to a part of the way across what the sliders span. At its ends nothing is cropped.
   */
  crop(axis, end, part) {
    const { bounds } = this.about;
    const at = this.model.anchor[axis] + this.model.span * (part - 0.5);
    const isOpen = part === (end === 'min' ? 0 : 1);
    const inside = Math.min(Math.max(at, bounds.min[axis]), bounds.max[axis]);
    this.shown.crop[end][axis] = isOpen ? bounds[end][axis] : inside;
  }

  /** Shows the model's whole box. */
  uncrop() {
    const { min, max } = this.about.bounds;
    this.shown.crop = { min: [...min], max: [...max] };
    document.querySelectorAll('#crop input').forEach((slider) => (slider.value = Number(slider.id.endsWith('max'))));
    if (this.camera) this.changed();
  }

  /** The picture and what is drawn over it, as the address of a PNG. */
  picture() {
    this.draw();
    const both = document.createElement('canvas');
    [both.width, both.height] = [this.overlay.width, this.overlay.height];
    const pen = both.getContext('2d');
    [this.canvas, this.overlay].forEach((layer) => pen.drawImage(layer, 0, 0));
    if (this.isSplit()) pen.fillRect(this.shown.split * both.width - 1, 0, 2, both.height);
    return both.toDataURL();
  }

  /** Saves the picture as a PNG. */
  save() {
    const link = document.createElement('a');
    link.href = this.picture();
    link.download = `${this.about.title}-${this.shown.layer}.png`.replace(/[^\w.-]+/g, '-');
    link.click();
  }

  /** True if colour stands on the left of the divider. */
  isSplit() {
    return this.shown.split !== null && this.shown.layer !== 'color';
  }

  /** What a picture of at most `side` pixels a side stands for. */
  few(shown, side) {
    const [w, h] = this.camera.resolution;
    const few = Math.min(1, side / Math.max(w, h));
    const [width, height] = [w, h].map((sides) => Math.max(1, Math.round(sides * few)));
    return this.renderer.measure(this.camera, shown, width, height);
  }

  /** Which part of the surface in view stays where it is when the slider removes matter; null if none is in view. */
  kept() {
    const { position, axes } = this.camera;
    const key = JSON.stringify([position, axes, this.shown.crop]);
    // Both at once while only the slider moves.
    if (this.whole?.key !== key) {
      this.whole = { key, numbers: this.few({ ...this.shown, threshold: this.about.prior, hidesUnseen: false }, 96) };
    }
    const [before, after] = [this.whole.numbers, this.few(this.shown, 96)];
    let [all, same] = [0, 0];
    for (let i = 0; i < before.length; i += 4) {
      if (before[i] <= 0.5) continue;
      all++;
      same += Number(after[i] > 0.5 && Math.abs(after[i + 1] - before[i + 1]) < SAME_DEPTH * before[i + 1]);
    }
    return all > 0 ? same / all : null;
  }

  /** Lets the colour bar of depth span what is in view. */
  fitDepths() {
    const numbers = this.few(this.shown, 48);
    const seen = [];
    for (let i = 0; i < numbers.length; i += 4) if (numbers[i] > 0.5) seen.push(numbers[i + 1]);
    if (seen.length > 0) {
      const [near, far] = [Math.min(...seen), Math.max(...seen)];
      this.shown.depths = [near, Math.max(far, near * (1 + 1e-6))];
    }
  }

  /** What is under an image point: position, depth, and what the model has there; null if nothing is hit. */
  read(x, y) {
    return this.renderer.read(this.camera, this.shown, x, y);
  }

  layer(name) {
    this.shown.layer = name;
    this.fitDepths();
    byId(`layer-${name}`).checked = true;
    this.changed();
  }

  threshold(log10U) {
    this.shown.threshold = log10U;
    byId('threshold').value = log10U;
    this.changed();
  }

  /** The camera was moved by hand. */
  moved() {
    cancelAnimationFrame(this.flight);
    this.changed(true);
  }

  /** Draws before the next frame; smaller while the camera moves. */
  changed(isMoving = false) {
    this.isMoving = isMoving;
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = null;
      this.draw(this.isMoving ? this.shrink : 1);
      clearTimeout(this.rest);
      if (this.isMoving) this.rest = setTimeout(() => this.changed(), 200);
    });
  }

  /** Draws now, with pixels that are `shrink` times as long; returns the time that it took, milliseconds. */
  draw(shrink = 1) {
    if (this.isLost) return 0;
    const [width, height] = this.fixed ?? this.size();
    [this.canvas.width, this.canvas.height] = [width, height].map((n) => Math.max(1, Math.round(n / shrink)));
    const start = performance.now();
    this.renderer.draw(this.camera, this.shown);
    this.renderer.finish();
    const took = performance.now() - start;
    if (this.isMoving) this.shrink = Math.min(8, Math.max(1, shrink * Math.sqrt(took / PATIENCE)));
    [this.overlay.width, this.overlay.height] = [width, height];
    if (this.frusta) drawFrusta(this.overlay, this.about.cameras, this.allFrusta(width, height), this.current);
    if (byId('crop').open) drawBox(this.overlay, this.camera, this.shown.crop, this.place(width, height));
    if (this.isMeasuring) drawEnds(this.overlay, this.camera, this.ends, this.place(width, height));
    showDivider(this.isSplit() ? this.shown : null);
    drawLegend(this.about, this.shown.layer, this.shown.depths);
    drawHistogram(this.about, this.shown.threshold);
    sayRemoved(this.model, this.shown, this.isMoving || this.shown.threshold >= this.about.prior ? null : this.kept());
    return took;
  }

  /** Takes image points of the moving camera to the canvas. */
  place(width, height) {
    const [x, y, z] = this.renderer.placing(this.camera, width, height);
    return ([u, v]) => [x + z * u, y + z * v];
  }

  allFrusta(width, height) {
    const place = this.place(width, height);
    return this.about.cameras.map((other) => frustum(this.camera, other, place, 0.08 * this.model.unit));
  }

  /** Size of the picture, device pixels. */
  size() {
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    return [clientWidth, clientHeight].map((n) => Math.max(1, Math.round(n * window.devicePixelRatio)));
  }

  /** The canvas point under a point of the page. */
  canvasPoint(event) {
    const box = this.canvas.getBoundingClientRect();
    const [width, height] = this.fixed ?? this.size();
    return [((event.clientX - box.left) / box.width) * width, ((event.clientY - box.top) / box.height) * height];
  }

  /** The image point under a point of the page. */
  imagePoint(event) {
    const [x, y, z] = this.renderer.placing(this.camera, ...(this.fixed ?? this.size()));
    const at = this.canvasPoint(event);
    return [(at[0] - x) / z, (at[1] - y) / z];
  }
}

/** Fills in what the file says of itself. */
function introduce({ words, about: { title, prior, range, quantity, cameras } }) {
  say('title', title);
  const planned = cameras.filter(({ isPlanned }) => isPlanned).length;
  say('model', `${words}, ${cameras.length - planned} cameras${planned > 0 ? `, ${planned} planned` : ''}`);
  const slider = byId('threshold');
  // Ends with two digits are whole steps apart. The last one removes nothing; the one before it is below the prior.
  const max = Math.ceil(100 * prior - 0.05);
  const min = Math.min(Math.floor(100 * range[0]), max - 1);
  Object.assign(slider, { min: (min / 100).toFixed(2), max: (max / 100).toFixed(2), step: '0.01' });
  slider.value = slider.max;
  drawTicks(slider, quantity);
}

async function start() {
  const status = byId('status');
  try {
    if (typeof DecompressionStream === 'undefined') {
      throw new Error('This browser cannot unpack the model (DecompressionStream).');
    }
    const model = await openModel(JSON.parse(byId('about').textContent));
    introduce(model);
    const viewer = new Viewer(model);
    listenToPointers(viewer);
    listenToKeys(viewer);
    listenToPanel(viewer);
    status.hidden = true;
    // A plan is there to be looked at.
    if (model.about.cameras.some(({ isPlanned }) => isPlanned)) byId('frusta').click();
    return viewer;
  } catch (error) {
    status.textContent = `${error.message} Any browser of the last years with graphics switched on will do.`;
    status.className = 'failed';
    throw error;
  }
}

// For the console, and for tests.
window.octobayes = start();
window.octobayes.catch(() => {});
