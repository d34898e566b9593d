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

/**
 * What is moved and cropped by: the middle of the model or of contracted space, a unit of length, the longest edge of
 * nearly all of the model, how much of it is looked at as a whole, and how far the sliders of the crop box reach.
 */
function lengths({ contraction, core }) {
  const edges = sub(core.max, core.min);
  const size = Math.max(...edges);
  if (contraction) {
    const { center, radius } = contraction;
    return { anchor: center, unit: radius, size, framed: 3 * radius, span: 8 * radius };
  }
  return { anchor: scale(add(core.min, core.max), 0.5), unit: size, size, framed: norm(edges), span: size };
}

/** Whether matter that no training ray reached is removed: by its switch, or with the slider in use. */
const removesUnseen = ({ threshold, hidesUnseen }, prior) => hidesUnseen || threshold < prior;

/** A number for people: four digits, without an exponent where none is needed. */
function words(x) {
  const size = Math.abs(x);
  if (x === 0) return '0';
  return size >= 1e-3 && size < 1e4 ? String(Number(x.toPrecision(4))) : x.toExponential(3);
}
