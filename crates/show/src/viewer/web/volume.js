// The volume on the CPU: what it says at a point, as the shader reads it.

class Volume {
  constructor({ about, pages, matter, knowledge, matterByCode, rays }) {
    Object.assign(this, { about, pages, matter, knowledge, matterByCode, rays }, lengths(about));
    this.words = `${about.cells} cells along the longest edge`;
    this.noun = 'matter, seen or hidden,';
  }

  renderer(canvas) {
    return new VolumeRenderer(canvas, this);
  }

  /** A scene point in the shader's units: see march.glsl. */
  local(x) {
    return scale(sub(x, this.anchor), 1 / this.unit);
  }

  /** Lattice coordinates of a scene point. */
  lattice(x) {
    const { contraction, grid } = this.about;
    let folded = x;
    if (contraction) {
      const y = this.local(x);
      const r = contraction.norm === 'l2' ? norm(y) : Math.max(...y.map(Math.abs));
      folded = r > 1 ? add(this.anchor, scale(y, ((2 - 1 / r) / r) * this.unit)) : x;
    }
    return scale(sub(folded, grid.origin), 1 / grid.edge);
  }

  /** Length of a cell's edge around a scene point, scene units. */
  length(x) {
    const { contraction, grid } = this.about;
    if (!contraction) return grid.edge;
    const y = this.local(x);
    const r = contraction.norm === 'l2' ? norm(y) : Math.max(...y.map(Math.abs));
    return r > 1 ? (grid.edge * r) / (2 - 1 / r) : grid.edge;
  }

  /**
   * What is interpolated for a code of log10 U at a point: U in parts of the prior, as in the field, if the field's
   * vertices are among the samples; else 1 plus log10 U in parts of its range, which leaves out less between them.
   */
  share(code) {
    const { codes, prior, holdsField } = this.about;
    const part = (Math.min(Math.max(code, 1), codes.last) - 1) / (codes.last - 1);
    return holdsField ? 10 ** ((part - 1) * (prior - codes.low)) : (1 + part) / 2;
  }

  /** log10 U of what was interpolated. */
  log10(share) {
    const { codes, prior, holdsField } = this.about;
    return holdsField ? prior + Math.log10(share) : codes.low + (2 * share - 1) * (prior - codes.low);
  }

  /** The same of log10 U. */
  shareOf(log10U) {
    const { codes, prior, holdsField } = this.about;
    const beyond = Math.min(log10U - prior, 0.1);
    return holdsField ? 10 ** beyond : 1 + beyond / (2 * (prior - codes.low));
  }

  /**
   * Texels of log10 U as it is seen, codes, and of shares at points, in 32768 parts and half as many again where no ray
   * came.
   */
  halves() {
    const { knowledge } = this;
    const codes = Uint16Array.from({ length: 256 }, (_, code) => half(code));
    const shares = Uint16Array.from({ length: 256 }, (_, code) => half(32768 * this.share(code)));
    shares[255] = half(49152);
    return Uint16Array.from(knowledge, (code, i) => (i % 2 === 0 ? codes[code] : shares[code]));
  }

  /** What the slider and the switch remove of all matter, what was never seen of it, and all. */
  removed(shown) {
    const { threshold } = shown;
    const { codes, prior, knowsUnseen } = this.about;
    const part = (threshold - codes.low) / (prior - codes.low);
    const last = threshold < prior ? 1 + (codes.last - 1) * part : codes.last;
    // What no training ray reached has a code of its own, if the field knows it, or the prior's.
    const first = knowsUnseen ? codes.last + 1 : codes.last;
    const sum = (of) => this.matterByCode.reduce((sum, weight, code) => sum + (of(code) ? weight : 0), 0);
    const [all, unseen] = [sum(() => true), sum((code) => code >= first)];
    const uncertain = sum((code) => code > Math.floor(last) && code < first);
    return { gone: uncertain + (removesUnseen(shown, prior) ? unseen : 0), unseen, all };
  }

  /** What is stored at a scene point: log10 U, whether it was seen, and in words the rest; null without matter. */
  at(x) {
    const { codes, knowsRays } = this.about;
    const found = this.sample(x);
    if (found === null) return null;
    const density = this.extinction(found, x) / codes.density;
    const more = [`density ${words(density)} per scene unit`];
    const count = Math.round(2 ** ((found.rays / codes.lastRays) * codes.rays) - 1);
    if (knowsRays) more.push(`training rays behind U: about ${words(count)}`);
    return { log10U: this.log10(found.share), isUnseen: found.unseen > 0.5, more };
  }

  /** What a scene unit absorbs of light at a point, where the lattice has this sample. */
  extinction({ absorbed }, x) {
    return -Math.log(Math.max(1 - absorbed, 0.001)) / this.length(x);
  }

  /**
   * The parts of a ray from a training camera through a scene point that the camera sees: distances of their middles,
   * their own variance along the ray, and their weights. The shader does the same.
   */
  hits(camera, at, x) {
    const { min, max } = this.about.bounds;
    const direction = unit(sub(x, camera.position));
    const ends = [0, 1, 2].map((k) => [min[k], max[k]].map((v) => (v - camera.position[k]) / (direction[k] || 1e-12)));
    let t = Math.max(0, ...ends.map((pair) => Math.min(...pair)));
    const last = Math.min(...ends.map((pair) => Math.max(...pair)));
    const hits = [];
    for (let passed = 1, i = 0; i < 4096 && t < last && passed > 0.003; i++) {
      const place = add(camera.position, scale(direction, t));
      const thickness = 0.5 * this.length(place);
      const found = this.sample(place);
      if (found !== null && found.absorbed > 4e-6) {
        const weight = passed * (1 - Math.exp(-thickness * this.extinction(found, place)));
        hits.push({ depth: t, variance: thickness ** 2 / 12, weight });
        passed -= weight;
      }
      t += thickness;
    }
    return hits;
  }

  /** log10 U at a scene point on a ray; the prior's without matter. */
  log10UAt(x) {
    const found = this.sample(x);
    return found === null ? this.about.prior : this.log10(found.share);
  }

  /** How wide the page's cells are. */
  resolution(x) {
    return this.length(x);
  }

  /** The lattice's interpolated values at a scene point; null without matter. */
  sample(x) {
    const { grid, codes, atlas } = this.about;
    const g = this.lattice(x);
    const brick = g.map((v, k) => Math.min(Math.max(Math.floor(v / 7), 0), grid.bricks[k] - 1));
    const page = 4 * (brick[0] + grid.bricks[0] * (brick[1] + grid.bricks[1] * brick[2]));
    if (this.pages[page + 3] > 0) return null;
    const inside = g.map((v, k) => Math.min(Math.max(v - 7 * brick[k], 0), 7));
    const first = inside.map((v) => Math.min(Math.floor(v), 6));
    const part = inside.map((v, k) => v - first[k]);
    const sums = [0, 0, 0];
    for (let corner = 0; corner < 8; corner++) {
      const bits = [corner & 1, (corner >> 1) & 1, corner >> 2];
      const weight = bits.reduce((w, bit, k) => w * (bit ? part[k] : 1 - part[k]), 1);
      const at = bits.map((bit, k) => 8 * this.pages[page + k] + first[k] + bit);
      const texel = at[0] + 8 * atlas[0] * (at[1] + 8 * atlas[1] * at[2]);
      sums[0] += weight * this.matter[4 * texel + 3];
      const code = this.knowledge[2 * texel + 1];
      sums[1] += weight * this.share(code);
      sums[2] += weight * (code > codes.last);
    }
    // Rays are known at every other sample.
    const near = inside.map((v) => Math.min(Math.round(v / 2), 3));
    const slot = this.pages[page] + atlas[0] * (this.pages[page + 1] + atlas[1] * this.pages[page + 2]);
    const rays = this.rays[64 * slot + near[0] + 4 * (near[1] + 4 * near[2])];
    return { absorbed: (sums[0] / 255) ** 2, share: sums[1], unseen: sums[2], rays };
  }
}

/** The bits of a number from 0 to 65504 as a float of 16 bits. */
function half(x) {
  if (x < 2 ** -14) return 0;
  const exponent = Math.floor(Math.log2(x));
  return ((exponent + 15) << 10) + Math.round((x / 2 ** exponent - 1) * 1024);
}

/** Unpacks the volume of the file. */
async function openModel(about) {
  const pages = await unpack('pages');
  const planes = await unpack('planes');
  // Every byte was stored as its difference to the one before it in its row of eight.
  for (let i = 0; i < planes.length; i++) {
    if (i % 8 !== 0) planes[i] = (planes[i] + planes[i - 1]) & 255;
  }
  return new Volume({ about, pages, ...atlas(about.atlas, planes) });
}

/**
 * The planes of all bricks, as texels of an atlas: red, green, blue, matter; and codes of log10 U, as it is seen and at
 * the point. Numbers of rays stay as they are, `[bricks][64]`. `matterByCode` is what matter absorbs, summed by its
 * code of log10 U at the point.
 */
function atlas([width, height, depth], planes) {
  const bricks = planes.length / (6 * 512 + 64);
  const matter = new Uint8Array(width * height * depth * 512 * 4);
  const knowledge = new Uint8Array(width * height * depth * 512 * 2);
  const matterByCode = new Array(256).fill(0);
  const plane = (k, from) => planes[k * bricks * 512 + from];
  for (let brick = 0; brick < bricks; brick++) {
    const x0 = 8 * (brick % width);
    const y0 = 8 * (Math.floor(brick / width) % height);
    const z0 = 8 * Math.floor(brick / (width * height));
    for (let i = 0; i < 512; i++) {
      const texel = x0 + (i & 7) + 8 * width * (y0 + ((i >> 3) & 7) + 8 * height * (z0 + (i >> 6)));
      const from = brick * 512 + i;
      // Red and blue are eighths of differences to green, with a sign.
      const green = plane(0, from);
      const beyond = (k) => Math.min(Math.max(green + 8 * ((plane(k, from) << 24) >> 24), 0), 255);
      matter[4 * texel] = beyond(1);
      matter[4 * texel + 1] = green;
      matter[4 * texel + 2] = beyond(2);
      matter[4 * texel + 3] = plane(3, from);
      // What no camera sees is shown as it is at the point.
      knowledge[2 * texel] = plane(4, from) || Math.min(plane(5, from), 254);
      knowledge[2 * texel + 1] = plane(5, from);
      matterByCode[plane(5, from)] += plane(3, from) ** 2;
    }
  }
  return { matter, knowledge, matterByCode, rays: planes.subarray(6 * 512 * bricks) };
}
