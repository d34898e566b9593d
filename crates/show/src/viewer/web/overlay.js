// Lines over the picture: frusta of the training cameras, and the crop box.

/** Apex and corners of a training camera's frustum on the canvas; null if one of them is behind the moving camera. */
function frustum(camera, other, place, length) {
  const corner = (x, y) => {
    const seen = [(x - other.center[0]) / other.focal[0], -(y - other.center[1]) / other.focal[1], -1];
    return add(other.position, scale(times(other.axes, seen), length));
  };
  const [w, h] = other.resolution;
  const corners = [corner(0, 0), corner(w, 0), corner(w, h), corner(0, h)];
  const points = [other.position, ...corners].map((x) => camera.project(x));
  return points.some((p) => p === null) ? null : points.map(place);
}

/** Draws frusta: `points` of each as [`frustum`] returns them. Those of a plan stand out. */
function drawFrusta(canvas, cameras, frusta, current) {
  const pen = canvas.getContext('2d');
  frusta.forEach((points, k) => {
    if (points === null) return;
    const [eye, ...image] = points;
    const { isPlanned } = cameras[k];
    if (k === current) pen.strokeStyle = '#ff8000';
    else pen.strokeStyle = isPlanned ? '#d000a8' : 'rgba(20, 90, 160, 0.55)';
    pen.lineWidth = k === current || isPlanned ? 2 : 1;
    pen.beginPath();
    for (const p of image) {
      pen.moveTo(...eye);
      pen.lineTo(...p);
    }
    image.forEach((p, i) => (i === 0 ? pen.moveTo(...p) : pen.lineTo(...p)));
    pen.closePath();
    pen.stroke();
  });
}

/** Which frustum has its apex, a corner or the middle of its image nearest to a canvas point; null if none is near. */
function picked(frusta, at, near) {
  let best = null;
  frusta.forEach((points, k) => {
    if (points === null) return;
    const middle = [0, 1].map((axis) => (points[1][axis] + points[3][axis]) / 2);
    const distance = Math.min(...[...points, middle].map((p) => Math.hypot(p[0] - at[0], p[1] - at[1])));
    if (distance <= (best?.distance ?? near)) best = { k, distance };
  });
  return best && best.k;
}

/** Draws the edges of a box. */
function drawBox(canvas, camera, { min, max }, place) {
  const pen = canvas.getContext('2d');
  pen.strokeStyle = '#d40000';
  const corner = (c) => [0, 1, 2].map((k) => (c & (1 << k) ? max : min)[k]);
  const corners = Array.from({ length: 8 }, (_, c) => camera.project(corner(c)));
  pen.beginPath();
  for (let c = 0; c < 8; c++) {
    for (const other of [1, 2, 4].map((bit) => c | bit).filter((o) => o > c)) {
      if (corners[c] === null || corners[other] === null) continue;
      pen.moveTo(...place(corners[c]));
      pen.lineTo(...place(corners[other]));
    }
  }
  pen.stroke();
}
