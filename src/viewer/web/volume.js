// The volume on the CPU: what it says at a point, as the shader reads it.

class Volume {
  constructor({ about, pages, matter, knowledge, matterByCode, rays }) {
    Object.assign(this, { about, pages, matter, knowledge, matterByCode, rays });
    const { min, max } = about.bounds;
    const size = sub(max, min);
    // The shader's units: see march.glsl.
    this.unit = about.contraction ? about.contraction.radius : Math.max(...size);
    this.anchor = about.contraction ? about.contraction.center : scale(add(min, max), 0.5);
    this.size = Math.max(...size);
  }

  /** A scene point in the shader's units. */
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
    const { codes, holdsField } = this.about;
    const part = (Math.min(Math.max(code, 1), codes.last) - 1) / (codes.last - 1);
    return holdsField ? 10 ** ((part - 1) * (codes.prior - codes.low)) : (1 + part) / 2;
  }

  /** log10 U of what was interpolated. */
  log10(share) {
    const { codes, holdsField } = this.about;
    return holdsField ? codes.prior + Math.log10(share) : codes.low + (2 * share - 1) * (codes.prior - codes.low);
  }

  /** The same of log10 U. */
  shareOf(log10U) {
    const { codes, holdsField } = this.about;
    const beyond = Math.min(log10U - codes.prior, 0.1);
    return holdsField ? 10 ** beyond : 1 + beyond / (2 * (codes.prior - codes.low));
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

  /** What is stored at a scene point: log10 U, density, rays and whether it was seen; null where there is no matter. */
  read(x) {
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
    const absorbed = (sums[0] / 255) ** 2;
    return {
      log10U: this.log10(sums[1]),
      density: -Math.log(Math.max(1 - absorbed, 0.001)) / this.length(x) / codes.density,
      rays: 2 ** ((rays / codes.lastRays) * codes.rays) - 1,
      isUnseen: sums[2] > 0.5,
    };
  }
}
