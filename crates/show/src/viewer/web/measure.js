// Lengths between two points of surfaces, with their deviation: that of `octobayes measure` from the field alone. The
// page does not have the field's vertices, so that errors that both ends share, which cancel, are counted for each.

/** Training cameras in whose views a point is looked for: the nearest of those that have it inside. */
const VIEWS = 12;

/** The image point of a scene point in a training camera, without its lens; null outside of its image. */
function inside({ position, axes, focal, center, resolution }, x) {
  const [right, up, back] = [0, 1, 2].map((k) => dot(column(axes, k), sub(x, position)));
  if (back >= -1e-9) return null;
  const at = [center[0] - (focal[0] * right) / back, center[1] + (focal[1] * up) / back];
  return at.every((v, k) => v > 0 && v < resolution[k]) ? at : null;
}

/** Edge of a cube that has the volume of one of the field's finest cells at a scene point. */
function cellAt({ contraction, deviation }, x) {
  if (!contraction) return deviation.cell;
  const y = scale(sub(x, contraction.center), 1 / contraction.radius);
  const r = contraction.norm === 'l2' ? norm(y) : Math.max(...y.map(Math.abs));
  // Contracted space is 1 / r² as long along the ray, and (2 − 1 / r) / r across it.
  return r <= 1 ? deviation.cell : deviation.cell * Math.cbrt(r ** 4 / (2 - 1 / r) ** 2);
}

/**
 * What a training camera shows where it has the scene point: the surface's position, its distance, and the standard
 * deviation along the direction of view, scene units; null if it shows none.
 */
function surfaceOf(model, camera, at, x) {
  const { deviation } = model.about;
  const hits = model.hits(camera, at, x);
  const opacity = hits.reduce((sum, { weight }) => sum + weight, 0);
  if (opacity <= 0.5) return null;
  const mean = (of) => hits.reduce((sum, hit) => sum + hit.weight * of(hit), 0) / opacity;
  let sum = 0;
  const median = hits.find(({ weight }) => (sum += weight) >= 0.5 * opacity).depth;
  const expected = mean(({ depth }) => depth);
  const variance = mean((hit) => (hit.depth - expected) ** 2 + hit.variance);
  const direction = unit(sub(x, camera.position));
  const place = add(camera.position, scale(direction, expected));
  const u = 10 ** model.log10UAt(place, hits) * ((deviation.cells * cellAt(model.about, place)) / median) ** 1.5;
  const sigma = Math.hypot(
    deviation.factor * Math.sqrt(Math.sqrt(variance) * u),
    0.5 * deviation.pixelAngle * median,
    // What the page rounds.
    model.resolution(place) / Math.sqrt(12),
  );
  const pixel = median / Math.min(...camera.focal);
  return { position: add(camera.position, scale(direction, median)), direction, distance: median, sigma, pixel, camera };
}

/** The surface at a scene point in the view of the training camera that determines it best; null if none sees it. */
function surveyed(model, x) {
  const distance = (camera) => norm(sub(x, camera.position));
  const cameras = model.about.cameras.map((camera) => ({ camera, at: inside(camera, x), far: distance(camera) }));
  const near = cameras.filter(({ camera, at }) => at !== null && !camera.isPlanned).sort((a, b) => a.far - b.far);
  let [best, seen] = [null, 0];
  for (const { camera, at, far } of near) {
    const found = surfaceOf(model, camera, at, x);
    if (found === null || Math.abs(found.distance - far) > model.about.deviation.jump * far) continue;
    if (best === null || found.sigma < best.sigma) best = found;
    if (++seen === VIEWS) break;
  }
  return best;
}

/** The length between two ends, and its standard deviation if both have one. */
function lengthBetween([a, b]) {
  const line = sub(b.position, a.position);
  const length = norm(line);
  if (!a.sigma || !b.sigma) return { length };
  const along = [a, b].map(({ sigma, direction }) => sigma * dot(direction, unit(line)));
  return { length, sigma: Math.hypot(...along, a.pixel / Math.sqrt(12), b.pixel / Math.sqrt(12)) };
}

/** An end of a length: where it was clicked, on the surface that a training camera sees there, if the field allows it. */
function endAt(model, found) {
  const surface = model.about.deviation ? surveyed(model, found.position) : null;
  return { position: found.position, ...surface, isUnseen: found.isUnseen };
}

/** A number with two digits of what is uncertain of it, without an exponent. */
function rounded(value, uncertain) {
  return value.toFixed(Math.min(Math.max(1 - Math.floor(Math.log10(uncertain)), 0), 9));
}

/** Says of the chosen ends what they are, and how far apart. */
function describeEnds({ about: { unit, deviation, cameras } }, ends) {
  if (ends.length === 0) return 'Click two points of surfaces.';
  const size = Math.max(...ends.flatMap(({ position }) => position.map(Math.abs))) * unit.factor;
  const lines = ends.map(({ position, sigma, camera, isUnseen }, k) => {
    const place = position.map((v) => rounded(unit.factor * v, size / 100)).join(',');
    const wide = deviation && deviation.ninety * sigma * unit.factor;
    if (sigma) return `${'AB'[k]} ${place}, ± ${rounded(wide, wide)} as seen by ${camera.name}`;
    const why = isUnseen ? 'no training ray came here' : 'no training camera sees it';
    return `${'AB'[k]} ${place}${deviation && cameras.length > 0 ? `: ${why}` : ''}`;
  });
  if (ends.length < 2) return [...lines, 'Click the other end.'].join('\n');
  const { length, sigma } = lengthBetween(ends);
  if (sigma) {
    const wide = deviation.ninety * sigma * unit.factor;
    return [...lines, `${rounded(unit.factor * length, wide)} ± ${rounded(wide, wide)} ${unit.name} (90 %)`].join('\n');
  }
  let why = 'an end is not seen';
  if (cameras.length === 0) why = 'the page has no training cameras';
  if (!deviation) why = 'the field is not in the scale of its data (`uncertainty --for depth`)';
  return [...lines, `${words(unit.factor * length)} ${unit.name}, without a deviation: ${why}`].join('\n');
}

/** Draws the ends and the line between them. */
function drawEnds(canvas, camera, ends, place) {
  const pen = canvas.getContext('2d');
  const points = ends.map(({ position }) => camera.project(position)).map((at) => at && place(at));
  // Light on dark, which shows on every ground.
  for (const [width, color] of [[5, '#1e1e1e'], [2.5, '#ffffff']]) {
    [pen.lineWidth, pen.strokeStyle] = [width, color];
    pen.beginPath();
    for (const at of points) {
      if (!at) continue;
      pen.moveTo(at[0] + 6, at[1]);
      pen.arc(...at, 6, 0, 2 * Math.PI);
    }
    if (points.length === 2 && points.every(Boolean)) {
      pen.moveTo(...points[0]);
      pen.lineTo(...points[1]);
    }
    pen.stroke();
  }
  pen.font = '600 16px system-ui, sans-serif';
  points.forEach((at, k) => {
    if (!at) return;
    [pen.lineWidth, pen.strokeStyle, pen.fillStyle] = [4, '#1e1e1e', '#ffffff'];
    pen.strokeText('AB'[k], at[0] + 9, at[1] - 9);
    pen.fillText('AB'[k], at[0] + 9, at[1] - 9);
  });
}
