// Wires everything together.

/** Longest time that a picture may take while the camera moves, milliseconds; it gets smaller instead. */
const PATIENCE = 80;
const LAYERS = ['color', 'depth', 'uncertainty', 'tinted'];

class Viewer {
  constructor(file) {
    const { about } = file;
    this.about = about;
    this.volume = new Volume(file);
    this.canvas = document.getElementById('picture');
    this.overlay = document.getElementById('overlay');
    this.renderer = new Renderer(this.canvas, this.volume);
    this.shown = { layer: 'color', threshold: about.codes.prior, range: about.range, depths: [0, 1] };
    this.current = 0;
    this.frusta = false;
    this.shrink = 1;
    const first = about.cameras[0] ?? this.someCamera();
    this.camera = new Orbit(first, about.cameras.length ? upright(about.cameras) : [0, 0, 1], this.volume.size);
    this.jump(0);
  }

  /** A view of the whole box, if there are no cameras. */
  someCamera() {
    const { min, max } = this.about.bounds;
    const back = unit([1, -1, 0.6]);
    const right = unit(cross([0, 0, 1], back));
    const position = add(scale(add(min, max), 0.5), scale(back, 1.6 * this.volume.size));
    const axes = [...right, ...cross(back, right), ...back];
    return { position, axes, focal: [500, 500], center: [256, 256], resolution: [512, 512] };
  }

  /** Goes to training camera k. */
  jump(k) {
    const { cameras } = this.about;
    if (cameras.length === 0) return;
    this.current = (k + cameras.length) % cameras.length;
    const camera = cameras[this.current];
    this.camera.jump(camera, this.volume.size);
    const { resolution, center } = this.camera;
    const hit = this.read(center[0], center[1]);
    if (hit) this.camera.distance = hit.depth;
    const name = `${camera.index}: ${camera.name} (${resolution.join(' × ')})`;
    const lens = camera.isDistorted ? ', drawn without the distortion of its lens' : '';
    document.getElementById('camera-name').textContent = name + lens;
    this.fitDepths();
    this.changed();
  }

  /** Lets the colour bar of depth span what is in view. */
  fitDepths() {
    const [w, h] = this.camera.resolution;
    const few = Math.min(1, 48 / Math.max(w, h));
    const size = [Math.max(1, Math.round(w * few)), Math.max(1, Math.round(h * few))];
    const numbers = this.renderer.measure(this.camera, this.shown, ...size);
    const seen = [];
    for (let i = 0; i < numbers.length; i += 4) if (numbers[i] > 0.5) seen.push(numbers[i + 1]);
    if (seen.length > 0) {
      const [near, far] = [Math.min(...seen), Math.max(...seen)];
      this.shown.depths = [near, Math.max(far, near * (1 + 1e-6))];
    }
  }

  /** What is under an image point: position, depth, and what the volume holds there; null if nothing is hit. */
  read(x, y) {
    // A target of one pixel, in whose middle the point lies.
    const [opacity, depth] = this.renderer.measure(this.camera, this.shown, 1, 1, [0.5 - x, 0.5 - y, 1]);
    if (opacity <= 0.5) return null;
    const position = add(this.camera.position, scale(this.camera.direction([x, y]), depth));
    return { position, depth, ...this.volume.read(position) };
  }

  layer(name) {
    this.shown.layer = name;
    this.fitDepths();
    document.getElementById(`layer-${name}`).checked = true;
    this.changed();
  }

  threshold(log10U) {
    this.shown.threshold = log10U;
    document.getElementById('threshold').value = log10U;
    this.changed();
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
    const [width, height] = this.fixed ?? this.size();
    [this.canvas.width, this.canvas.height] = [width, height].map((n) => Math.max(1, Math.round(n / shrink)));
    const start = performance.now();
    this.renderer.draw(this.camera, this.shown);
    this.renderer.finish();
    const took = performance.now() - start;
    if (this.isMoving) this.shrink = Math.min(8, Math.max(1, shrink * Math.sqrt(took / PATIENCE)));
    [this.overlay.width, this.overlay.height] = [width, height];
    if (this.frusta) this.drawFrusta(width, height);
    drawLegend(this.about, this.shown.layer, this.shown.depths);
    drawHistogram(this.about, this.shown.threshold);
    sayRemoved(this.about, this.volume.matterByCode, this.shown.threshold);
    return took;
  }

  drawFrusta(width, height) {
    const [x, y, z] = this.renderer.placing(this.camera, width, height);
    const place = ([u, v]) => [x + z * u, y + z * v];
    drawFrusta(this.overlay, this.camera, this.about.cameras, this.current, place, 0.08 * this.volume.unit);
  }

  /** Size of the picture, device pixels. */
  size() {
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    return [clientWidth, clientHeight].map((n) => Math.max(1, Math.round(n * window.devicePixelRatio)));
  }

  /** The image point under a point of the page. */
  imagePoint(event) {
    const box = this.canvas.getBoundingClientRect();
    const [width, height] = this.fixed ?? this.size();
    const [x, y, z] = this.renderer.placing(this.camera, width, height);
    const at = [((event.clientX - box.left) / box.width) * width, ((event.clientY - box.top) / box.height) * height];
    return [(at[0] - x) / z, (at[1] - y) / z];
  }
}

/** Mouse, touch and keys. */
function listen(viewer) {
  const byId = (id) => document.getElementById(id);
  const area = byId('area');
  const pointers = new Map();
  const speed = () => 4 / Math.min(area.clientWidth, area.clientHeight);
  const moved = () => viewer.changed(true);

  area.addEventListener('pointerdown', (event) => {
    area.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const name of ['pointerup', 'pointercancel']) {
    area.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  area.addEventListener('pointermove', (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) {
      byId('reading').textContent = describe(viewer.about, viewer.read(...viewer.imagePoint(event)));
      return;
    }
    const others = [...pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    const [x, y] = [event.clientX - before[0], event.clientY - before[1]];
    const isPan = event.shiftKey || event.buttons & 6;
    if (others.length > 0) {
      // Two fingers: their distance zooms, each moves the scene by half.
      const apart = (at) => Math.hypot(at[0] - others[0][0], at[1] - others[0][1]);
      viewer.camera.zoom(apart(before) / Math.max(apart([event.clientX, event.clientY]), 1));
      viewer.camera.pan(x / 2, y / 2);
    } else if (isPan) {
      viewer.camera.pan(x, y);
    } else {
      viewer.camera.orbit(-x * speed(), -y * speed());
    }
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    moved();
  });
  area.addEventListener('contextmenu', (event) => event.preventDefault());
  area.addEventListener('wheel', (event) => {
    event.preventDefault();
    viewer.camera.zoom(Math.exp(0.001 * event.deltaY));
    moved();
  }, { passive: false });

  const keys = {
    ArrowLeft: () => viewer.camera.orbit(0.08, 0), ArrowRight: () => viewer.camera.orbit(-0.08, 0),
    ArrowUp: () => viewer.camera.orbit(0, 0.08), ArrowDown: () => viewer.camera.orbit(0, -0.08),
    w: () => viewer.camera.pan(0, 24), s: () => viewer.camera.pan(0, -24),
    a: () => viewer.camera.pan(24, 0), d: () => viewer.camera.pan(-24, 0),
    '+': () => viewer.camera.zoom(0.9), '-': () => viewer.camera.zoom(1 / 0.9),
  };
  const jumps = {
    n: () => viewer.jump(viewer.current + 1),
    p: () => viewer.jump(viewer.current - 1),
    r: () => viewer.jump(viewer.current),
    f: () => byId('frusta').click(),
  };
  window.addEventListener('keydown', (event) => {
    if (event.target.matches('input[type=range], input[type=number]') || event.ctrlKey || event.metaKey) return;
    const layer = LAYERS[Number(event.key) - 1];
    if (keys[event.key]) {
      event.preventDefault();
      keys[event.key]();
      moved();
    } else if (jumps[event.key]) {
      jumps[event.key]();
    } else if (layer) {
      viewer.layer(layer);
    }
  });

  LAYERS.forEach((name) => byId(`layer-${name}`).addEventListener('change', () => viewer.layer(name)));
  const slider = byId('threshold');
  slider.addEventListener('input', () => {
    // The last position removes nothing, however it was rounded.
    viewer.shown.threshold = slider.value === slider.max ? viewer.about.codes.prior : Number(slider.value);
    moved();
  });
  byId('frusta').addEventListener('change', (event) => {
    viewer.frusta = event.target.checked;
    viewer.changed();
  });
  byId('previous').addEventListener('click', () => viewer.jump(viewer.current - 1));
  byId('next').addEventListener('click', () => viewer.jump(viewer.current + 1));
  window.addEventListener('resize', () => viewer.changed());
}

/** Fills in what the file says of itself. */
function introduce({ title, cells, codes, range, cameras }) {
  document.getElementById('title').textContent = title;
  document.getElementById('volume').textContent = `${cells} cells along the longest edge, ${cameras.length} cameras`;
  const slider = document.getElementById('threshold');
  // Ends with two digits are whole steps apart. The last one removes nothing; the one before it is below the prior.
  const max = Math.ceil(100 * codes.prior - 0.05);
  const min = Math.min(Math.floor(100 * range[0]), max - 1);
  Object.assign(slider, { min: (min / 100).toFixed(2), max: (max / 100).toFixed(2), step: '0.01' });
  slider.value = slider.max;
}

async function start() {
  const status = document.getElementById('status');
  try {
    if (typeof DecompressionStream === 'undefined') {
      throw new Error('This browser cannot unpack the volume (DecompressionStream).');
    }
    const file = await readFile();
    introduce(file.about);
    const viewer = new Viewer(file);
    listen(viewer);
    status.hidden = true;
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
