// What was learned about the robot: each number with its sigma, and how both went.

import { timeAxis } from '../model/time_axis.js';
import { Chart } from '../view/chart.js';
import { button, element, scrolled, setText } from '../view/dom.js';
import { withSigma } from '../view/format.js';

const HEIGHT_PX = 36;
const MOST_POINTS = 300;

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
    body.append(empty, scrolled('Learned numbers', element('table', {},
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
          row.chart.remove();
          row.line.remove();
          rows.delete(name);
        }
        for (const entry of learned.values()) {
          let row = rows.get(entry.name);
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
  const value = element('span');
  const readout = element('span', { class: 'at' });
  const host = element('td', { class: 'spark' });
  const line = element('tr', {}, element('th', { scope: 'row', text: title(entry) }), element('td', { class: 'number' }, value, readout), host);
  const chart = new Chart(host, {
    label: `${entry.name} over time with two sigma`,
    lines: [
      { label: '+2 sigma', colour: 'ellipse', hidden: true },
      { label: '-2 sigma', colour: 'ellipse', hidden: true },
      { label: 'value', colour: 'estimate', width: 1.6 },
    ],
    bands: [[1, 2]],
    say: ([upper, , learned]) => withSigma(learned, (upper - learned) / 2),
    readout, isSmall: true, height: HEIGHT_PX,
  });
  return { line, value, chart };
}

// The name without the unit that it ends in: the value has it.
function title(entry) {
  const suffix = `_${entry.unit.replaceAll('/', '_per_')}`;
  const name = entry.unit !== '' && entry.name.endsWith(suffix) ? entry.name.slice(0, -suffix.length) : entry.name;
  return name.replaceAll('_', ' ');
}

function drawRow(row, entry, until_s) {
  const { track } = entry;
  const { value, sigma, t_s } = track.columns;
  const last = track.rowUntil(until_s);
  setText(row.value, last < 0 ? '–' : withSigma(value[last], sigma[last], entry.unit));
  const { from_s, to_s } = timeAxis.span;
  const rows = track.shown(from_s, to_s, MOST_POINTS);
  const columns = [rows.map((at) => t_s[at]), rows.map((at) => value[at] + 2 * sigma[at]), rows.map((at) => value[at] - 2 * sigma[at]), rows.map((at) => value[at])];
  row.chart.range = rangeOf(columns);
  row.chart.draw(columns);
}

// That of the widest band that is shown, so that one sees it shrink.
function rangeOf([, upper, lower]) {
  const [low, high] = [Math.min(...lower), Math.max(...upper)];
  return high > low ? [low, high] : [low - 1, low + 1];
}
