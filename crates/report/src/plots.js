// Plots as inline SVG.

// Of the scheme of the page.
const colourOf = k => `var(--series-${k % 4})`;

function element(name, attributes = {}, ...children) {
  const isSvg = ['svg', 'rect', 'path', 'line', 'text', 'title'].includes(name);
  const made = isSvg
    ? document.createElementNS('http://www.w3.org/2000/svg', name)
    : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

// Longer tables are folded.
const MOST_ROWS = 40;

// A plot below its title, which is also its name for those who do not see it.
function titled(title, plot) {
  plot.setAttribute('role', 'img');
  plot.setAttribute('aria-label', title);
  return element('div', {}, element('h3', {}, title), plot);
}

// A heading spans the empty headings on its right.
function table({ caption, head, rows }) {
  const heading = line => {
    const cells = [];
    line.forEach((text, k) => {
      if (k > 1 && !text) cells[cells.length - 1].colSpan += 1;
      else if (text) cells.push(element('th', { scope: 'col' }, text));
      else cells.push(element('td'));
    });
    return element('tr', {}, ...cells);
  };
  const row = ([name, values]) =>
    element(
      'tr',
      {},
      element('th', { scope: 'row' }, name),
      ...values.map(text => element('td', {}, text)),
    );
  // Without headings, a row is the name of a fact and the fact.
  const isFacts = !head.length;
  const made = element(
    'table',
    {},
    ...(isFacts ? [] : [element('thead', {}, ...head.map(heading))]),
    element('tbody', {}, ...rows.map(row)),
  );
  const folded = () => element('details', {}, element('summary', {}, `all ${rows.length}`), made);
  return element(
    'div',
    isFacts ? { class: 'facts' } : { class: 'wide', tabindex: 0 },
    ...(caption ? [element('h2', {}, caption)] : []),
    rows.length > MOST_ROWS ? folded() : made,
  );
}

const short = value =>
  Math.abs(value) >= 1e5
    ? value.toExponential(1)
    : String(+value.toPrecision(Math.abs(value) < 1 ? 2 : 4));

// ---- Axes ----

// Smallest and largest number; `Math.min(...values)` overflows the stack.
const range = values =>
  values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [
    Infinity,
    -Infinity,
  ]);
// The range, wider if its ends cannot be told apart.
function widened([low, high]) {
  if (!(low <= high)) return [0, 1];
  const size = Math.max(Math.abs(low), Math.abs(high));
  if (high - low > 1e-9 * size) return [low, high];
  return size > 0 ? [low - 0.5 * size, high + 0.5 * size] : [-1, 1];
}
// Multiples of 1, 2 or 5 times a power of ten: at least three in a range, or two if only whole
// numbers are wanted.
function stepOf([low, high], whole) {
  const largest = (high - low) / 3;
  let power = 10 ** Math.floor(Math.log10(largest));
  // The logarithm may be a rounding error off.
  if (power > largest) power /= 10;
  const step = power * [5, 2, 1].find(digit => digit * power <= largest * (1 + 1e-12));
  return whole ? Math.max(1, step) : step;
}
const SUPERSCRIPTS = '⁰¹²³⁴⁵⁶⁷⁸⁹';
const superscript = power =>
  (power < 0 ? '⁻' : '') + [...String(Math.abs(power))].map(digit => SUPERSCRIPTS[digit]).join('');
// Places of ticks and their labels. Labels have as many decimals as tell them apart. What would
// make them long stands in `note`: a power of ten, or a number to add to each.
function ticks(bounds, whole = false) {
  const step = stepOf(bounds, whole);
  const places = [];
  for (let k = Math.ceil(bounds[0] / step - 1e-6); k * step <= bounds[1] + 1e-6 * step; k++)
    places.push(k * step);
  const largest = Math.max(...places.map(Math.abs));
  const isOffset = largest / step >= 1e5;
  const base = isOffset ? places[0] : 0;
  const shown = isOffset ? places.map((_, k) => k * step) : places;
  const most = isOffset ? step * places.length : largest;
  const power = most >= 1e5 || most < 1e-2 ? 3 * Math.floor(Math.log10(most) / 3) : 0;
  const decimals = Math.max(0, power - Math.floor(Math.log10(step) + 1e-9));
  const labels = shown.map(value => (value / 10 ** power + 0).toFixed(decimals));
  const baseDecimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const note =
    (power ? `×10${superscript(power)}` : '') +
    (isOffset ? ` + ${base.toFixed(Math.min(baseDecimals, 20))}` : '');
  return { places, labels, note: note.trim(), step };
}

// ---- Plots in a frame of 420 x 164 ----
const FRAME = { width: 420, height: 164, left: 52, right: 12, top: 16, bottom: 34 };

// Axes through the ranges x and y; that of y is rounded to its ticks.
function frame(x, y, xLabel, { wholeX = false, wholeY = false } = {}) {
  const { width, height, left, right, top, bottom } = FRAME;
  const { step } = ticks(y, wholeY);
  y = [Math.floor(y[0] / step + 1e-6) * step, Math.ceil(y[1] / step - 1e-6) * step];
  const [across, up] = [ticks(x, wholeX), ticks(y, wholeY)];
  const toX = value => left + ((value - x[0]) / (x[1] - x[0])) * (width - left - right);
  const toY = value => height - bottom - ((value - y[0]) / (y[1] - y[0])) * (height - top - bottom);
  const svg = element('svg', { viewBox: `0 0 ${width} ${height}` });
  const label = (axis, text, x, y, anchor) =>
    svg.append(element('text', { x, y, 'text-anchor': anchor, 'data-axis': axis }, text));
  up.places.forEach((value, k) => {
    const at = toY(value);
    svg.append(
      element('line', { x1: left, x2: width - right, y1: at, y2: at, class: 'grid' }),
    );
    label('y', up.labels[k], left - 4, at + 4, 'end');
  });
  across.places.forEach((value, k) => {
    const at = toX(value);
    const [y1, y2] = [height - bottom, height - bottom + 3];
    svg.append(element('line', { x1: at, x2: at, y1, y2, class: 'tick' }));
    label('x', across.labels[k], at, height - bottom + 14, 'middle');
  });
  const unit = [across.note, xLabel].filter(text => text).join(' ');
  label('unit', unit, (left + width - right) / 2, height - 5, 'middle');
  label('unit', up.note, 4, 10, 'start');
  return { svg, toX, toY };
}

// The last bin counts all larger values, too.
function histogram({ first, last, counts }, xLabel, isWhole) {
  const most = range(counts)[1];
  const { svg, toX, toY } = frame([first, last], [0, Math.max(most, 2)], xLabel, {
    wholeX: isWhole,
    wholeY: true,
  });
  const step = (last - first) / counts.length;
  counts.forEach((count, k) =>
    svg.append(
      element(
        'rect',
        {
          x: toX(first + k * step),
          width: Math.max(toX(step) - toX(0) - 0.6, 0.4),
          y: toY(count),
          height: toY(0) - toY(count),
          style: `fill:${colourOf(0)}`,
        },
        element('title', {}, `${short(first + k * step)}: ${count}`),
      ),
    ),
  );
  return svg;
}

// `abscissae` holds those of each series. The ordinate includes the numbers `shown`.
function lines(abscissae, series, xLabel, shown = []) {
  const { svg, toX, toY } = frame(
    widened(range(abscissae.flat())),
    widened(range(series.flat().concat(shown))),
    xLabel,
  );
  const point = (x, y, i) => `${i ? 'L' : 'M'}${toX(x).toFixed(1)} ${toY(y).toFixed(1)}`;
  series.forEach((values, k) =>
    svg.append(
      element('path', {
        d: values.map((value, i) => point(abscissae[k][i], value, i)).join(''),
        style: `fill:none;stroke:${colourOf(k)};stroke-width:1.3`,
      }),
    ),
  );
  return svg;
}

// ---- Trajectories from above with equal scales of both axes ----

// The true one is grey. Errors are enlarged, so that the largest is an eighth of the drive.
const SHOWN_ERROR = 1 / 8;
function extent(points) {
  const [x, y] = [0, 1].map(k => range(points.map(point => point[k])));
  return { low: [x[0], y[0]], high: [x[1], y[1]] };
}
function magnification(trajectories) {
  const { low, high } = extent(trajectories[0].truth_above);
  const largest = range(trajectories.flatMap(one => one.horizontal))[1];
  const factor = (SHOWN_ERROR * Math.hypot(high[0] - low[0], high[1] - low[1])) / largest;
  if (!(factor > 1) || !isFinite(factor)) return 1;
  const power = 10 ** Math.floor(Math.log10(factor));
  return power * [5, 2, 1].find(digit => digit * power <= factor);
}
function above(trajectories, factor) {
  const drawn = trajectories.map(({ truth_above, estimated_above }) =>
    truth_above.map((truth, i) =>
      truth.map((value, k) => value + factor * (estimated_above[i][k] - value)),
    ),
  );
  const { low, high } = extent(trajectories.map(one => one.truth_above).concat(drawn).flat());
  const [width, maxHeight, margin] = [840, 420, 10];
  const scale = Math.min(
    (width - 2 * margin) / (high[0] - low[0] || 1),
    (maxHeight - 2 * margin - 14) / (high[1] - low[1] || 1),
  );
  const height = (high[1] - low[1]) * scale + 2 * margin + 14;
  const svg = element('svg', { viewBox: `0 0 ${width} ${height}` });
  const place = ([x, y], i) =>
    `${i ? 'L' : 'M'}${(margin + (x - low[0]) * scale).toFixed(1)} ` +
    (margin + (high[1] - y) * scale).toFixed(1);
  const path = (points, stroke, wide) =>
    svg.append(
      element('path', {
        d: points.map(place).join(''),
        style: `fill:none;stroke:${stroke};stroke-width:${wide};stroke-linejoin:round`,
      }),
    );
  path(trajectories[0].truth_above, 'var(--truth)', 6);
  drawn.forEach((points, k) => path(points, colourOf(k), 2));
  const metres = 10 ** Math.floor(Math.log10((high[0] - low[0]) / 2 || 1));
  const [end, bottom] = [margin + metres * scale, height - 4];
  svg.append(
    element('line', { x1: margin, x2: end, y1: bottom, y2: bottom, class: 'tick' }),
    element('text', { x: end + 6, y: height - 1 }, `${metres} m`),
  );
  return svg;
}
// The trajectories of all models over each other, with their errors below.
function comparison(models) {
  const trajectories = models.map(model => model.trajectory);
  const factor = magnification(trajectories);
  const rms = values =>
    Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length);
  const errors = trajectories.map(({ horizontal, vertical }) =>
    horizontal.map((value, i) => Math.hypot(value, vertical[i])),
  );
  const legend = models.map((model, k) =>
    element(
      'span',
      { style: `color:${colourOf(k)}` },
      `\u25ac ${model.name}: position error ${(100 * rms(errors[k])).toFixed(1)} cm (RMS)`,
    ),
  );
  const enlarged = factor > 1 ? `, their distances to the true path enlarged ${factor} times` : '';
  const truth = element('span', { class: 'note' }, '\u25ac true path');
  const lengths = trajectories.map(one => one.path_length);
  return element(
    'div',
    { class: 'comparison' },
    element('p', {}, truth, ...legend),
    titled(
      `Estimated paths of the first camera from above${enlarged}`,
      above(trajectories, factor),
    ),
    titled(
      'Position error of the first camera along the drive (m)',
      lines(lengths, errors, 'm driven', [0]),
    ),
  );
}

function matrix({ side, counts }) {
  const most = Math.log1p(Math.max(range(counts)[1], 1));
  const svg = element('svg', {
    viewBox: `0 0 ${side} ${side}`,
    'shape-rendering': 'crispEdges',
    class: 'matrix',
  });
  counts.forEach((count, k) => {
    if (!count) return;
    const [x, y] = [k % side, Math.floor(k / side)];
    const opacity = (Math.log1p(count) / most).toFixed(2);
    const style = `fill:${colourOf(0)};fill-opacity:${opacity}`;
    svg.append(element('rect', { x, y, width: 1, height: 1, style }));
  });
  return svg;
}

function bars(pairs) {
  const [height, most] = [18, Math.max(...pairs.map(pair => pair[1]), 1e-9)];
  const svg = element('svg', { viewBox: `0 0 420 ${height * pairs.length}` });
  pairs.forEach(([name, value], k) => {
    const [width, y] = [(280 * value) / most, k * height];
    svg.append(
      element('text', { x: 0, y: y + 13 }, name),
      element('rect', { x: 64, y: y + 3, height: height - 6, width, style: `fill:${colourOf(0)}` }),
      element('text', { x: 70 + width, y: y + 13 }, short(value) + ' s'),
    );
  });
  return svg;
}
