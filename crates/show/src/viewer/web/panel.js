// The panel beside the picture: legend, and the threshold with its histogram.

/** What the layers are called. */
const NAMES = { color: 'colour', depth: 'depth', uncertainty: 'log10 U', tinted: 'tinted' };

const say = (id, text) => (byId(id).textContent = text);

/** Puts the divider of the split view where it is; away if nothing is split. */
function showDivider(shown) {
  const divider = byId('divider');
  divider.hidden = shown === null;
  if (shown === null) return;
  divider.style.left = `${100 * shown.split}%`;
  say('divider-right', NAMES[shown.layer]);
}

/** Writes numbers under the slider: whole ones, halves or every other one. */
function drawTicks(slider, quantity) {
  const [min, max] = [Number(slider.min), Number(slider.max)];
  const step = [0.1, 0.5, 1, 2].find((step) => max - min <= 6 * step) ?? 5;
  const ticks = byId('ticks');
  for (let k = Math.ceil(min / step); k * step <= max; k++) {
    const tick = ticks.appendChild(document.createElement('span'));
    tick.textContent = Number((k * step).toFixed(1));
    // The thumb is 16 pixels wide, and its middle stands at the value.
    tick.style.left = `calc(8px + ${(k * step - min) / (max - min)} * (100% - 16px))`;
  }
  say('threshold-unit', quantity);
}

/** Draws the colour bar of the layer, with words for people beside its ends. */
function drawLegend(about, layer, depths) {
  const bar = byId('bar').getContext('2d');
  const isDepth = layer === 'depth';
  byId('legend').hidden = layer === 'color';
  const map = isDepth ? about.maps.depth : about.maps.uncertainty;
  map.forEach((color, i) => {
    bar.fillStyle = `rgb(${color})`;
    bar.fillRect(i, 0, 1, 16);
  });
  const [low, high] = isDepth ? depths : about.range;
  const { factor, name } = about.unit;
  say('legend-name', isDepth ? `depth (${name})` : `${about.quantity}: larger = less certain`);
  say('legend-low', isDepth ? words(factor * low) : `${low.toFixed(2)} well constrained`);
  say('legend-high', isDepth ? words(factor * high) : `${high.toFixed(2)} never seen`);
  say('hatching', isDepth || !about.knowsUnseen ? '' : 'Hatched: no training ray came here.');
}

/** Draws how many points of visible surfaces have which log10 U, in its colours, and where the threshold is. */
function drawHistogram(about, threshold) {
  const canvas = byId('histogram');
  const pen = canvas.getContext('2d');
  const bars = about.histogram;
  const most = Math.max(1, ...bars);
  const width = canvas.width / bars.length;
  pen.clearRect(0, 0, canvas.width, canvas.height);
  bars.forEach((n, i) => {
    // Few must still be seen.
    const height = n === 0 ? 0 : 2 + (canvas.height - 2) * Math.sqrt(n / most);
    pen.fillStyle = `rgb(${about.maps.uncertainty[Math.round((255 * (i + 0.5)) / bars.length)]})`;
    pen.fillRect(i * width, canvas.height - height, width - 1, height);
  });
  const [low, high] = [about.range[0], about.prior];
  const x = ((threshold - low) / (high - low)) * canvas.width;
  pen.fillStyle = 'rgba(255, 255, 255, 0.75)';
  pen.fillRect(x, 0, canvas.width - x, canvas.height);
  pen.fillStyle = '#d40000';
  pen.fillRect(Math.min(x, canvas.width - 2), 0, 2, canvas.height);
}

/** Says which part of what is in view the slider leaves, and what it and the switch remove of all matter. */
function sayRemoved(model, shown, kept) {
  const { prior } = model.about;
  const { threshold } = shown;
  const percent = (part, all) => `${((100 * part) / all).toFixed(1)} %`;
  const share = kept === null ? '' : `: ${percent(kept, 1)} of the surface in view stays`;
  const words = threshold < prior ? `log10 U ≤ ${threshold.toFixed(2)}${share}` : 'the slider removes nothing';
  say('threshold-words', words);
  const box = byId('hide-unseen');
  [box.checked, box.disabled] = [removesUnseen(shown, prior), threshold < prior];
  const { gone, unseen, all } = model.removed(shown);
  const never = `${percent(unseen, all)} was never seen`;
  say('unseen-words', all > 0 ? `Of all ${model.noun} ${percent(gone, all)} is removed; ${never}.` : '');
}

/** Says what is under the pointer. */
function describe(about, found) {
  if (!found) return 'nothing is hit here';
  const { factor, name } = about.unit;
  const lines = [
    `position ${found.position.map((v) => words(factor * v)).join(', ')}`,
    `depth ${words(factor * found.depth)} ${name}`,
  ];
  if (found.log10U !== undefined) {
    const u = 10 ** found.log10U;
    const length = about.isLength ? `U ${words(factor * u)} ${name}` : `U ${words(u)}`;
    lines.push(`log10 U ${found.log10U.toFixed(2)} (${length}), larger = less certain`);
    const prior = `prior, "never seen": ${about.prior.toFixed(2)}`;
    lines.push(found.isUnseen ? 'no training ray came here: U is the prior’s' : prior);
    lines.push(...found.more);
  }
  return lines.join('\n');
}
