// What was learned about the robot: each number with its sigma, and how both went.

import { button, element, setText } from '../view/dom.js';
import { withSigma } from '../view/format.js';
import { palette } from '../view/palette.js';
import { translucent } from '../view/chart.js';

const WIDTH_PX = 150;
const HEIGHT_PX = 34;

export const calibration = {
  id: 'calibration',
  title: 'Biases and calibration',
  isOfRobot: true,
  isShown: (view) => !view.session.hasOnlyQuantities(),
  build(body, station) {
    const table = element('tbody');
    const empty = element('p', { class: 'note', text: 'Nothing was learned yet.' });
    const rows = new Map();
    const ask = (command) => () => station.commandRobot({ command });
    body.append(empty, element('div', { class: 'scroll' }, element('table', {},
      element('thead', {}, element('tr', {}, ...['number', 'value ± sigma', 'how it went, 2 σ'].map((text) => element('th', { scope: 'col', text })))), table)),
    element('div', { class: 'actions' },
      button('Freeze', ask('freeze-calibration'), { title: 'Keep what was learned as it is' }),
      button('Learn on', ask('learn-calibration'), { title: 'Go on learning' }),
      button('Begin anew', ask('reset-calibration'), { title: 'Forget what was learned' })));
    return {
      draw(view) {
        const learned = new Map([...(view.robot?.calibration ?? [])].filter(([, entry]) => entry.isLearned));
        empty.hidden = learned.size > 0;
        for (const [name, row] of rows) {
          if (learned.has(name)) continue;
          row.line.remove();
          rows.delete(name);
        }
        for (const entry of learned.values()) {
          let row = rows.get(entry.name);
          if (row && row.track !== entry.track) {
            row.track = entry.track;
            row.revision = -1;
          }
          if (!row) {
            row = newRow(entry);
            rows.set(entry.name, row);
            table.append(row.line);
          }
          drawRow(row, entry, view.until_s);
        }
      },
    };
  },
};

function newRow(entry) {
  const value = element('td', { class: 'number' });
  const canvas = element('canvas', { class: 'spark', role: 'img', 'aria-label': `${entry.name} over time with two sigma` });
  const scale = globalThis.devicePixelRatio || 1;
  canvas.width = WIDTH_PX * scale;
  canvas.height = HEIGHT_PX * scale;
  const context = canvas.getContext('2d');
  context.scale(scale, scale);
  const line = element('tr', {}, element('th', { scope: 'row', text: title(entry) }), value, element('td', {}, canvas));
  return { line, value, context, track: entry.track, revision: -1, until_s: NaN };
}

// The name without the unit that it ends in: the value has it.
function title(entry) {
  const suffix = `_${entry.unit.replaceAll('/', '_per_')}`;
  const name = entry.unit !== '' && entry.name.endsWith(suffix) ? entry.name.slice(0, -suffix.length) : entry.name;
  return name.replaceAll('_', ' ');
}

function drawRow(row, entry, until_s) {
  const { track } = entry;
  const last = track.rowUntil(until_s);
  if (last < 0) {
    setText(row.value, '–');
    row.revision = -1;
    row.context.clearRect(0, 0, WIDTH_PX, HEIGHT_PX);
    return;
  }
  const value = track.columns.value[last];
  const sigma = track.columns.sigma[last];
  setText(row.value, withSigma(value, sigma, entry.unit));
  if (row.revision === track.revision && row.until_s === until_s) return;
  row.revision = track.revision;
  row.until_s = until_s;
  spark(row.context, track, last + 1);
}

// Value with its band of two sigma; the scale is that of the widest band, so that one sees it shrink.
function spark(context, track, to) {
  const { t_s, value, sigma } = track.columns;
  const from = track.begin;
  let low = Infinity;
  let high = -Infinity;
  for (let row = from; row < to; row += 1) {
    low = Math.min(low, value[row] - 2 * sigma[row]);
    high = Math.max(high, value[row] + 2 * sigma[row]);
  }
  context.clearRect(0, 0, WIDTH_PX, HEIGHT_PX);
  if (!(high > low)) return;
  const span_s = Math.max(1e-6, t_s[to - 1] - t_s[from]);
  const x = (row) => 1 + ((t_s[row] - t_s[from]) / span_s) * (WIDTH_PX - 4);
  const y = (at) => HEIGHT_PX - 2 - ((at - low) / (high - low)) * (HEIGHT_PX - 4);
  context.beginPath();
  for (let row = from; row < to; row += 1) context.lineTo(x(row), y(value[row] + 2 * sigma[row]));
  for (let row = to - 1; row >= from; row -= 1) context.lineTo(x(row), y(value[row] - 2 * sigma[row]));
  context.closePath();
  context.fillStyle = translucent(palette.ellipse);
  context.fill();
  context.beginPath();
  for (let row = from; row < to; row += 1) context.lineTo(x(row), y(value[row]));
  context.strokeStyle = palette.estimate;
  context.lineWidth = 1.6;
  context.stroke();
}
