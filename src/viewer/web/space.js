// Vectors as arrays of three numbers, matrices as arrays of nine, column by column.

const add = (a, b) => a.map((v, i) => v + b[i]);
const sub = (a, b) => a.map((v, i) => v - b[i]);
const scale = (a, s) => a.map((v) => v * s);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const norm = (a) => Math.sqrt(dot(a, a));
const unit = (a) => scale(a, 1 / (norm(a) || 1));
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const column = (m, k) => m.slice(3 * k, 3 * k + 3);
const times = (m, v) => [0, 1, 2].map((row) => m[row] * v[0] + m[3 + row] * v[1] + m[6 + row] * v[2]);

/** The vector turned about a unit axis, radians. */
function turned(v, axis, angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return add(add(scale(v, c), scale(cross(axis, v), s)), scale(axis, dot(axis, v) * (1 - c)));
}

/** The bits of a number from 0 to 65504 as a float of 16 bits. */
function half(x) {
  if (x < 2 ** -14) return 0;
  const exponent = Math.floor(Math.log2(x));
  return ((exponent + 15) << 10) + Math.round((x / 2 ** exponent - 1) * 1024);
}

/** A number for people: four digits, without an exponent where none is needed. */
function words(x) {
  const size = Math.abs(x);
  if (x === 0) return '0';
  return size >= 1e-3 && size < 1e4 ? String(Number(x.toPrecision(4))) : x.toExponential(3);
}
