// Splats on the CPU: their parameters, their order, and what a pixel shows of them.

class Splats {
  constructor(about, planes) {
    Object.assign(this, { about, ...unpacked(about, planes) }, lengths(about));
    this.words = `${about.count} of ${about.all} splats`;
    this.noun = 'splats';
    this.order = { key: null, list: null };
  }

  renderer(canvas) {
    return new SplatsRenderer(canvas, this);
  }

  /** A scene point relative to the anchor of the stored positions. */
  local(x) {
    return sub(x, this.about.codes.anchor);
  }

  /** Whether slider and switch leave splat i. */
  stays(i, shown) {
    const { prior } = this.about;
    if (this.unseen[i]) return !removesUnseen(shown, prior);
    return this.log10U[i] <= shown.threshold || shown.threshold >= prior;
  }

  /** The splats that are left in front of a camera, from the farthest to the nearest along the view axis. */
  listed(camera, shown) {
    const { position, axes } = camera;
    const key = JSON.stringify([position, axes, shown.threshold, shown.hidesUnseen, shown.crop]);
    if (key === this.order.key) return this.order.list;
    const { means } = this;
    const [low, high] = [this.local(shown.crop.min), this.local(shown.crop.max)];
    const [x, y, z] = scale(column(axes, 2), -1);
    const eye = dot([x, y, z], this.local(position));
    const depths = new Float32Array(this.about.count);
    const left = new Uint32Array(this.about.count);
    let count = 0;
    for (let i = 0; i < this.about.count; i++) {
      const [a, b, c] = [means[3 * i], means[3 * i + 1], means[3 * i + 2]];
      depths[i] = x * a + y * b + z * c - eye;
      const isInside =
        a >= low[0] && b >= low[1] && c >= low[2] && a <= high[0] && b <= high[1] && c <= high[2];
      if (isInside && depths[i] > this.about.drawn.near && this.stays(i, shown)) left[count++] = i;
    }
    this.order = { key, list: farthestFirst(left.subarray(0, count), depths) };
    return this.order.list;
  }

  /**
   * Splat i on the image of a `lens`, written into `out`; false if no pixel shows it. The shader does the same, and
   * both do what crates/splats/src/render/project.rs explains.
   */
  project(i, { eye, rows: [right, down, forward], focal, center, limits: [low, high] }, out) {
    // Plain numbers: a hundred thousand splats are projected for every move of the pointer.
    const { means, covariances: c } = this;
    const [m, n] = [3 * i, 6 * i];
    const [px, py, pz] = [means[m] - eye[0], means[m + 1] - eye[1], means[m + 2] - eye[2]];
    const x = right[0] * px + right[1] * py + right[2] * pz;
    const y = down[0] * px + down[1] * py + down[2] * pz;
    const z = forward[0] * px + forward[1] * py + forward[2] * pz;
    // Rows of the Jacobian in scene axes.
    const [tx, ty] = [Math.min(Math.max(x / z, low[0]), high[0]), Math.min(Math.max(y / z, low[1]), high[1])];
    const [fx, fy] = [focal[0] / z, focal[1] / z];
    const u0 = fx * (right[0] - tx * forward[0]);
    const u1 = fx * (right[1] - tx * forward[1]);
    const u2 = fx * (right[2] - tx * forward[2]);
    const v0 = fy * (down[0] - ty * forward[0]);
    const v1 = fy * (down[1] - ty * forward[1]);
    const v2 = fy * (down[2] - ty * forward[2]);
    const cu0 = c[n] * u0 + c[n + 1] * u1 + c[n + 2] * u2;
    const cu1 = c[n + 1] * u0 + c[n + 3] * u1 + c[n + 4] * u2;
    const cu2 = c[n + 2] * u0 + c[n + 4] * u1 + c[n + 5] * u2;
    const cv0 = c[n] * v0 + c[n + 1] * v1 + c[n + 2] * v2;
    const cv1 = c[n + 1] * v0 + c[n + 3] * v1 + c[n + 4] * v2;
    const cv2 = c[n + 2] * v0 + c[n + 4] * v1 + c[n + 5] * v2;
    const raw00 = u0 * cu0 + u1 * cu1 + u2 * cu2;
    const raw01 = v0 * cu0 + v1 * cu1 + v2 * cu2;
    const raw11 = v0 * cv0 + v1 * cv1 + v2 * cv2;
    const { isMip, dilation, drawn } = this.about;
    const [a, d] = [raw00 + dilation, raw11 + dilation];
    const determinant = a * d - raw01 * raw01;
    const inner = Math.max(raw00 * raw11 - raw01 * raw01, 0);
    const opacity = this.opacities[i] * (isMip ? Math.sqrt(inner / determinant) : 1);
    const reach = 2 * Math.log(opacity / drawn.faintest);
    if (!(reach >= 0 && determinant > 0)) return false;
    [out.opacity, out.depth] = [opacity, z];
    [out.x, out.y] = [(focal[0] * x) / z + center[0], (focal[1] * y) / z + center[1]];
    [out.xx, out.xy, out.yy] = [d / determinant, -raw01 / determinant, a / determinant];
    [out.width, out.height] = [Math.sqrt(reach * a), Math.sqrt(reach * d)];
    return true;
  }

  /** Calls `visit(pixel, alpha, splat, i)` for what the pixels of a target may show of splats, from the nearest. */
  forEachPixel(camera, shown, lens, width, height, [left, top, zoom], visit) {
    const list = this.listed(camera, shown);
    const { faintest, mostOpaque } = this.about.drawn;
    const splat = {};
    for (let k = list.length - 1; k >= 0; k--) {
      if (!this.project(list[k], lens, splat)) continue;
      const { x, y, xx, xy, yy, opacity } = splat;
      const first = Math.max(Math.ceil(left + zoom * (x - splat.width) - 0.5), 0);
      const last = Math.min(Math.floor(left + zoom * (x + splat.width) - 0.5), width - 1);
      const highest = Math.max(Math.ceil(top + zoom * (y - splat.height) - 0.5), 0);
      const lowest = Math.min(Math.floor(top + zoom * (y + splat.height) - 0.5), height - 1);
      for (let row = highest; row <= lowest; row++) {
        const dy = y - (row + 0.5 - top) / zoom;
        for (let at = first; at <= last; at++) {
          const dx = x - (at + 0.5 - left) / zoom;
          const q = xx * dx * dx + 2 * xy * dx * dy + yy * dy * dy;
          const alpha = Math.min(opacity * Math.exp(-0.5 * q), mostOpaque);
          if (alpha >= faintest) visit(row * width + at, alpha, splat, list[k]);
        }
      }
    }
  }

  /**
   * What the pixels of a target show, from the top left: opacity, depth (the median along the ray, scene units),
   * log10 U, which part of it was never seen, and the number of splats.
   */
  pixels(camera, shown, lens, width, height, placing) {
    const all = Array.from({ length: width * height }, () => ({ passed: 1, isFull: false, hits: [] }));
    this.forEachPixel(camera, shown, lens, width, height, placing, (at, alpha, { depth }, i) => {
      const pixel = all[at];
      const after = pixel.passed * (1 - alpha);
      // Nothing is drawn behind the end of a ray.
      pixel.isFull ||= after < this.about.drawn.dark;
      if (pixel.isFull) return;
      pixel.hits.push({ i, depth, weight: pixel.passed * alpha });
      pixel.passed = after;
    });
    return all.map(({ passed, hits }, at) => {
      const opacity = 1 - passed;
      const mean = (of) => hits.reduce((sum, { i, weight }) => sum + weight * of[i], 0) / opacity;
      let sum = 0;
      const median = hits.find(({ weight }) => (sum += weight) >= 0.5 * opacity);
      const tangent = [at % width, Math.floor(at / width)].map((n, k) =>
        ((n + 0.5 - placing[k]) / placing[2] - lens.center[k]) / lens.focal[k]);
      const depth = median ? median.depth * Math.hypot(...tangent, 1) : 0;
      return { opacity, depth, log10U: mean(this.log10U), unseen: mean(this.unseen), count: hits.length };
    });
  }

  /**
   * The splats that a training camera sees at an image point, from the nearest: distances along the ray, their own
   * variance along it, weights.
   */
  hits(camera, at) {
    const lens = this.lens(camera, [0, 0], camera.resolution);
    const { near, faintest, mostOpaque, dark } = this.about.drawn;
    const found = [];
    const splat = {};
    for (let i = 0; i < this.about.count; i++) {
      if (!this.project(i, lens, splat) || splat.depth <= near) continue;
      const [dx, dy] = [splat.x - at[0], splat.y - at[1]];
      const q = splat.xx * dx * dx + 2 * splat.xy * dx * dy + splat.yy * dy * dy;
      const alpha = Math.min(splat.opacity * Math.exp(-0.5 * q), mostOpaque);
      if (alpha >= faintest) found.push({ i, alpha, z: splat.depth });
    }
    const oblique = Math.hypot(...[0, 1].map((k) => (at[k] - camera.center[k]) / camera.focal[k]), 1);
    const hits = [];
    let passed = 1;
    for (const { i, alpha, z } of found.sort((a, b) => a.z - b.z)) {
      if (passed * (1 - alpha) < dark) break;
      const variance = oblique ** 2 * this.variance(i, lens.rows[2]);
      hits.push({ i, depth: z * oblique, variance, weight: passed * alpha });
      passed *= 1 - alpha;
    }
    return hits;
  }

  /** A splat's variance along a direction. */
  variance(i, [x, y, z]) {
    const [xx, xy, xz, yy, yz, zz] = this.covariances.subarray(6 * i, 6 * i + 6);
    return xx * x * x + yy * y * y + zz * z * z + 2 * (xy * x * y + xz * x * z + yz * y * z);
  }

  /** log10 of the mean U of what a ray hits: the page has U at the middles of splats alone. */
  log10UAt(x, hits) {
    const sum = (of) => hits.reduce((sum, hit) => sum + hit.weight * of(hit), 0);
    return Math.log10(sum(({ i }) => 10 ** this.log10U[i]) / sum(() => 1));
  }

  /** Splats are as they are. */
  resolution() {
    return 0;
  }

  /**
   * What projects splats for a camera whose image shows the part between two image points. Splats beyond its edges are
   * projected as at a margin.
   */
  lens({ position, axes, focal, center }, low, high) {
    const tangents = [low, high].map((at) => at.map((v, k) => (v - center[k]) / focal[k]));
    const margin = [0, 1].map((k) => 0.5 * (this.about.drawn.beyond - 1) * (tangents[1][k] - tangents[0][k]));
    const [right, up, back] = [0, 1, 2].map((k) => column(axes, k));
    return {
      focal, center, eye: this.local(position), rows: [right, scale(up, -1), scale(back, -1)],
      limits: [tangents[0].map((v, k) => v - margin[k]), tangents[1].map((v, k) => v + margin[k])],
    };
  }

  /** How many splats the slider and the switch remove, how many were never seen, and all. */
  removed(shown) {
    let [gone, unseen] = [0, 0];
    for (let i = 0; i < this.about.count; i++) {
      gone += Number(!this.stays(i, shown));
      unseen += this.unseen[i];
    }
    return { gone, unseen, all: this.about.count };
  }
}

/** Splats by depth, from the farthest: two counting sorts by 16 bits. Positive floats are as large as their bits. */
function farthestFirst(splats, depths) {
  const bits = new Uint32Array(depths.buffer);
  const sorted = (from, shift) => {
    const starts = new Uint32Array(65537);
    for (const i of from) starts[65535 - ((bits[i] >>> shift) & 65535) + 1]++;
    for (let k = 0; k < 65536; k++) starts[k + 1] += starts[k];
    const to = new Uint32Array(from.length);
    for (const i of from) to[starts[65535 - ((bits[i] >>> shift) & 65535)]++] = i;
    return to;
  };
  return sorted(sorted(splats, 0), 16);
}

/** The parameters of all splats, from the bytes of viewer/splats.rs. */
function unpacked({ count, codes, prior, knowsUnseen }, planes) {
  const bytes = new Uint8Array(planes.length);
  for (let k = 0; k < codes.bytes; k++) {
    for (let i = 0; i < count; i++) bytes[codes.bytes * i + k] = planes[k * count + i];
  }
  const data = new DataView(bytes.buffer);
  const floats = (width) => new Float32Array(width * count);
  const [means, covariances, colors, opacities, log10U] = [3, 6, 3, 1, 1].map(floats);
  const unseen = new Uint8Array(count);
  const [shortest, longest] = codes.logScales;
  for (let i = 0; i < count; i++) {
    const at = codes.bytes * i;
    for (let k = 0; k < 3; k++) {
      means[3 * i + k] = data.getFloat32(at + 4 * k, true);
      colors[3 * i + k] = (codes.color * bytes[at + 19 + k]) / 255;
    }
    const scales = [12, 13, 14].map((k) => Math.exp(shortest + ((longest - shortest) * bytes[at + k]) / 255));
    covariances.set(covariance(rotation(data.getUint32(at + 15, true), codes.halfTurn), scales), 6 * i);
    opacities[i] = bytes[at + 22] / 255;
    log10U[i] = codes.low + ((prior - codes.low) * data.getUint16(at + 23, true)) / codes.prior;
    // Where the field does not store what no ray reached, it is what has the prior's U.
    unseen[i] = knowsUnseen ? bytes[at + 25] : Number(log10U[i] >= prior + Math.log10(0.999));
  }
  return { means, covariances, colors, opacities, log10U, unseen };
}

/** A quaternion x, y, z, w from three entries of ten bits; above them, which the largest is. */
function rotation(code, halfTurn) {
  const q = [0, 0, 0, 0];
  const largest = code >>> 30;
  const others = [0, 1, 2, 3].filter((k) => k !== largest);
  others.forEach((k, place) => (q[k] = (((code >>> (20 - 10 * place)) & 1023) / halfTurn - 1) / Math.SQRT2));
  q[largest] = Math.sqrt(Math.max(1 - q.reduce((sum, v) => sum + v * v, 0), 0));
  return q;
}

/** Entries 00, 01, 02, 11, 12 and 22 of the covariance of a splat. */
function covariance([x, y, z, w], scales) {
  const axes = [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
  const entry = ([row, col]) => axes.reduce((sum, axis, k) => sum + scales[k] ** 2 * axis[row] * axis[col], 0);
  return [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]].map(entry);
}

/** Unpacks the splats of the file. */
async function openModel(about) {
  return new Splats(about, await unpack('planes'));
}
