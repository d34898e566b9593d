// The panel beside the picture: legend, and the threshold with its histogram.

/** Draws the colour bar of the layer, with words for people beside its ends. */
function drawLegend(about, layer, depths) {
  const bar = document.getElementById('bar').getContext('2d');
  const isDepth = layer === 'depth';
  document.getElementById('legend').hidden = layer === 'color';
  const map = isDepth ? about.maps.depth : about.maps.uncertainty;
  map.forEach((color, i) => {
    bar.fillStyle = `rgb(${color})`;
    bar.fillRect(i, 0, 1, 16);
  });
  const say = (id, text) => (document.getElementById(id).textContent = text);
  const [low, high] = isDepth ? depths : about.range;
  say('legend-name', isDepth ? 'depth (scene units)' : `${about.quantity}: larger = less certain`);
  say('legend-low', isDepth ? words(low) : `${low.toFixed(2)} well constrained`);
  say('legend-high', isDepth ? words(high) : `${high.toFixed(2)} never seen`);
  say('hatching', isDepth || !about.knowsUnseen ? '' : 'Hatched: no training ray came here.');
}

/** Draws how many points of visible surfaces have which log10 U, in its colours, and where the threshold is. */
function drawHistogram(about, threshold) {
  const canvas = document.getElementById('histogram');
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
  const [low, high] = [about.range[0], about.codes.prior];
  const x = ((threshold - low) / (high - low)) * canvas.width;
  pen.fillStyle = 'rgba(255, 255, 255, 0.75)';
  pen.fillRect(x, 0, canvas.width - x, canvas.height);
  pen.fillStyle = '#d40000';
  pen.fillRect(Math.min(x, canvas.width - 2), 0, 2, canvas.height);
}

/** Says what the threshold removes of visible surfaces, and of what was never seen. */
function sayRemoved(about, matterByCode, threshold) {
  const { codes, surfaces } = about;
  const say = (id, text) => (document.getElementById(id).textContent = text);
  if (threshold >= codes.prior) {
    say('threshold-words', 'nothing is removed');
    say('unseen-words', '');
    return;
  }
  const percent = (part, all) => `${((100 * part) / all).toFixed(1)} %`;
  const kept = surfaces.filter((log10U) => log10U <= threshold).length;
  const share = surfaces.length > 0 ? `${percent(kept, surfaces.length)} of visible surfaces stay` : '';
  say('threshold-words', `log10 U ≤ ${threshold.toFixed(2)}: ${share}`);
  const last = 1 + ((codes.last - 1) * (threshold - codes.low)) / (codes.prior - codes.low);
  const sum = (from) => matterByCode.reduce((sum, weight, code) => sum + (code >= from ? weight : 0), 0);
  const [all, gone, unseen] = [sum(0), sum(Math.floor(last) + 1), sum(codes.last)];
  const never = `${percent(unseen, all)} has the prior’s U (“never seen”) and goes at any threshold`;
  say('unseen-words', all > 0 ? `Of all matter, seen or hidden, ${percent(gone, all)} goes. ${never}.` : '');
}

/** Says what is under the pointer. */
function describe(about, found) {
  if (!found) return 'nothing is hit here';
  const lines = [
    `position ${found.position.map(words).join(', ')}`,
    `depth ${words(found.depth)} scene units`,
  ];
  if (found.log10U !== undefined) {
    const length = about.isLength ? `U ${words(10 ** found.log10U)} scene units` : `U ${words(10 ** found.log10U)}`;
    lines.push(`log10 U ${found.log10U.toFixed(2)} (${length}), larger = less certain`);
    const prior = `prior, "never seen": ${about.codes.prior.toFixed(2)}`;
    lines.push(found.isUnseen ? 'no training ray came here: U is the prior’s' : prior);
    lines.push(`density ${words(found.density)} per scene unit`);
    if (about.knowsRays) lines.push(`training rays behind U: about ${words(Math.round(found.rays))}`);
  }
  return lines.join('\n');
}
