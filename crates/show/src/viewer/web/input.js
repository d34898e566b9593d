// Mouse, touch, keys and the controls of the panel.

/** Parts of the target's distance that a key moves, and radians that it turns. */
const STEP = 0.05;
const TURN = 0.08;
/** A press that travels less is a click, CSS pixels; so near to a frustum, it is a click on it. */
const STILL = 4;
const NEAR = 14;

/** Mouse and touch on the picture. */
function listenToPointers(viewer) {
  const area = byId('area');
  const pointers = new Map();
  let [travelled, onDivider] = [0, false];
  const speed = () => 4 / Math.min(area.clientWidth, area.clientHeight);

  area.addEventListener('pointerdown', (event) => {
    area.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    [travelled, onDivider] = [0, event.target.closest('#divider') !== null];
  });
  area.addEventListener('pointerup', (event) => {
    pointers.delete(event.pointerId);
    const isClick = event.button === 0 && travelled < STILL && !onDivider;
    if (!isClick) return;
    const k = viewer.pick(event, NEAR);
    if (k !== null) viewer.fly(k);
    else if (viewer.isMeasuring) viewer.mark(...viewer.imagePoint(event));
  });
  area.addEventListener('pointercancel', (event) => pointers.delete(event.pointerId));
  area.addEventListener('pointermove', (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) {
      area.style.cursor = viewer.pick(event, NEAR) === null ? '' : 'pointer';
      say('reading', describe(viewer.about, viewer.read(...viewer.imagePoint(event))));
      return;
    }
    const others = [...pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    const [x, y] = [event.clientX - before[0], event.clientY - before[1]];
    travelled += Math.hypot(x, y);
    if (onDivider) {
      const part = viewer.canvasPoint(event)[0] / viewer.overlay.width;
      viewer.shown.split = Math.min(Math.max(part, 0.02), 0.98);
    } else if (others.length > 0) {
      // Two fingers: their distance zooms, each moves the scene by half.
      const apart = (at) => Math.hypot(at[0] - others[0][0], at[1] - others[0][1]);
      viewer.camera.zoom(apart(before) / Math.max(apart([event.clientX, event.clientY]), 1));
      viewer.camera.pan(x / 2, y / 2);
    } else if (event.shiftKey || event.buttons & 6) {
      viewer.camera.pan(x, y);
    } else {
      viewer.camera.orbit(-x * speed(), -y * speed());
    }
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    viewer.moved();
  });
  area.addEventListener('contextmenu', (event) => event.preventDefault());
  area.addEventListener('dblclick', (event) => {
    // Two clicks near to each other may be a short length.
    if (!onDivider && !viewer.isMeasuring) viewer.focus(...viewer.imagePoint(event));
  });
  area.addEventListener('wheel', (event) => {
    event.preventDefault();
    viewer.camera.zoom(Math.exp(0.001 * event.deltaY));
    viewer.moved();
  }, { passive: false });
}

/** Keys: those that move the camera, and those that do something once. */
function listenToKeys(viewer) {
  const { camera } = viewer;
  const moves = {
    ArrowLeft: () => camera.orbit(-TURN, 0), ArrowRight: () => camera.orbit(TURN, 0),
    ArrowUp: () => camera.orbit(0, -TURN), ArrowDown: () => camera.orbit(0, TURN),
    w: () => camera.move(0, 0, STEP), s: () => camera.move(0, 0, -STEP),
    a: () => camera.move(-STEP, 0, 0), d: () => camera.move(STEP, 0, 0),
    q: () => camera.move(0, -STEP, 0), e: () => camera.move(0, STEP, 0),
    '+': () => camera.zoom(0.9), '-': () => camera.zoom(1 / 0.9),
  };
  const others = {
    n: () => viewer.jump(viewer.current + 1),
    p: () => viewer.jump(viewer.current - 1),
    r: () => viewer.jump(viewer.current),
    f: () => viewer.frame(),
    i: () => viewer.save(),
    '?': () => (byId('help').open ? byId('help').close() : byId('help').showModal()),
  };
  for (const [key, id] of Object.entries({ c: 'frusta', m: 'measure', v: 'split', u: 'level', h: 'hide-unseen' })) {
    others[key] = () => byId(id).click();
  }
  others.b = () => (byId('crop').open = !byId('crop').open);
  window.addEventListener('keydown', (event) => {
    const isOfSlider = event.target.matches('input[type=range]') && /^(Arrow|Home|End|Page)/.test(event.key);
    if (isOfSlider || event.ctrlKey || event.metaKey || event.altKey) return;
    const layer = LAYERS[Number(event.key) - 1];
    if (moves[event.key]) {
      event.preventDefault();
      moves[event.key]();
      viewer.moved();
    } else if (others[event.key]) {
      others[event.key]();
    } else if (layer) {
      viewer.layer(layer);
    }
  });
}

/** The panel. */
function listenToPanel(viewer) {
  const { shown } = viewer;
  const on = (id, name, act) => byId(id).addEventListener(name, (event) => act(event.target));
  LAYERS.forEach((name) => on(`layer-${name}`, 'change', () => viewer.layer(name)));
  on('threshold', 'input', (slider) => {
    // The last position removes nothing, however it was rounded.
    shown.threshold = slider.value === slider.max ? viewer.about.prior : Number(slider.value);
    viewer.moved();
  });
  const boxes = {
    'hide-unseen': (isOn) => (shown.hidesUnseen = isOn),
    split: (isOn) => (shown.split = isOn ? 0.5 : null),
    frusta: (isOn) => (viewer.frusta = isOn),
    measure: (isOn) => {
      [viewer.isMeasuring, viewer.ends] = [isOn, []];
      say('length', isOn ? describeEnds(viewer.model, []) : '');
    },
    level: (isOn) => {
      viewer.camera.isLevel = isOn;
      viewer.camera.orbit(0, 0);
    },
  };
  for (const [id, act] of Object.entries(boxes)) {
    on(id, 'change', (box) => {
      act(box.checked);
      viewer.changed();
    });
  }
  on('previous', 'click', () => viewer.jump(viewer.current - 1));
  on('next', 'click', () => viewer.jump(viewer.current + 1));
  on('save', 'click', () => viewer.save());
  on('help-button', 'click', () => byId('help').showModal());
  on('crop', 'toggle', () => viewer.changed());
  [0, 1, 2].forEach((axis) => {
    ['min', 'max'].forEach((end) => {
      on(`crop-${'xyz'[axis]}-${end}`, 'input', (slider) => {
        viewer.crop(axis, end, Number(slider.value));
        viewer.moved();
      });
    });
  });
  on('uncrop', 'click', () => viewer.uncrop());
  window.addEventListener('resize', () => viewer.changed());
}
