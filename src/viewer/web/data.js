// What the file holds: numbers and names as JSON, the volume as base 64 of zlib.

const byId = (id) => document.getElementById(id);

/** Bytes of an element's base 64, unpacked. */
async function unpack(id) {
  const text = byId(id).textContent.trim();
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Everything in the file: `about` as written by octobayes, pages of bricks, and the atlas as texels. */
async function readFile() {
  const about = JSON.parse(byId('about').textContent);
  const pages = await unpack('pages');
  const planes = await unpack('planes');
  // Every byte was stored as its difference to the one before it in its row of eight.
  for (let i = 0; i < planes.length; i++) {
    if (i % 8 !== 0) planes[i] = (planes[i] + planes[i - 1]) & 255;
  }
  return { about, pages, ...atlas(about.atlas, planes) };
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
