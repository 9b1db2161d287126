// What each source said against what was expected: innovations with two sigma, and NIS with its chi-square band.

import { nisBand } from '../model/chi_square.js';
import { MARKS, isRefused } from '../model/marks.js';
import { timeAxis } from '../model/time_axis.js';
import { Chart, roundUp } from '../view/chart.js';
import { element, scrolled, setText } from '../view/dom.js';
import { compact, count, fixed } from '../view/format.js';

// More points are thinned.
const MOST_POINTS = 2048;
const NIS_FLOOR = 1e-3;
// A NIS beyond is drawn near the edge.
const NIS_RANGE = [NIS_FLOOR, 100];
const NIS_MOST = 75;
// How much of an innovation's chart its band of two sigma takes.
const BAND_SHARE = 0.6;
// And where marks beyond the chart stand.
const EDGE = 0.93;
// The column of the values as they were, behind those that are drawn.
const TRUE_VALUE = 5;
const RANGE_STEPS = [1, 1.5, 2, 3, 4, 5, 7];

// Components of an innovation by the observation's kind, as docs/maths/pose.md orders them; for fixes they are those of the robot's body.
const COMPONENTS = new Map([
  ['fix', [['ahead', 'm'], ['to the left', 'm'], ['heading', 'rad']]],
  ['wheel_angles', [['turn of gyro against wheels', 'rad']]],
  ['odometer_pose', [['turn of gyro against odometer', 'rad']]],
  ['compass_heading', [['heading', 'rad']]],
  ['wall_range', [['range', 'm']]],
  ['beacon_range', [['range', 'm']]],
  ['landmark', [['range', 'm'], ['bearing', 'rad']]],
]);

export const innovations = {
  id: 'innovations',
  title: 'Innovations and NIS',
  isOfRobot: true,
  build: (body, station) => new InnovationsPanel(body, station),
};

class InnovationsPanel {
  constructor(body, station) {
    this.station = station;
    this.rows = new Map();
    this.switchesShown = '';
    this.robotId = null;
    this.chosen = null;
    this.shape = '';
    this.charts = [];
    this.table = element('tbody');
    this.host = element('div', { class: 'charts' });
    this.empty = element('p', { class: 'note', text: 'No observation has come yet.' });
    body.append(
      this.empty,
      scrolled('Sources', element('table', { class: 'sources' },
        element('thead', {}, element('tr', {}, ...['source', 'seen', 'gated', 'late', 'NIS', 'verdict', 'last', 'use'].map((text) => element('th', { scope: 'col', text })))),
        this.table)),
      this.host,
    );
  }

  draw(view) {
    const sources = view.robot?.sources ?? new Map();
    this.empty.hidden = sources.size > 0;
    this.#rowsFor(sources, view);
    this.#showSwitches(view.robot);
    const source = sources.get(this.chosen) ?? firstWithNis(sources);
    if (!source) return;
    // Until somebody chooses, one that is heard later may be the better first.
    for (const [sensor, row] of this.rows) {
      if (row.radio.checked !== (sensor === source.sensor)) row.radio.checked = sensor === source.sensor;
    }
    this.#chartsFor(source, view.robot.id);
    this.#drawCharts(source);
  }

  #rowsFor(sources, view) {
    for (const [sensor, row] of this.rows) {
      if (sources.has(sensor)) continue;
      row.line.remove();
      this.rows.delete(sensor);
    }
    for (const [sensor, source] of sources) {
      const row = this.rows.get(sensor) ?? this.#newRow(source, view.robot);
      const judged = source.judged(view.until_s);
      for (const name of ['seen', 'gated', 'late']) setText(row[name], count(source.counted(name, view.until_s)));
      setText(row.nis, judged ? fixed(judged.nis, 2) : '–');
      setText(row.consistency, judged?.consistency ?? '–');
      const verdict = source.verdict(view.until_s);
      setText(row.last, verdict);
      row.line.dataset.verdict = verdict;
    }
  }

  #newRow(source, robot) {
    const name = source.sensor;
    if (this.station.idOf(name) === undefined) this.station.renewSources();
    const radio = element('input', { type: 'radio', name: 'source', on: { change: () => this.#choose(source.sensor) } });
    const use = element('input', {
      type: 'checkbox', 'aria-label': `Use ${name}`, on: { change: () => this.#switch(name, use.checked) },
      disabled: this.station.idOf(name) === undefined,
    });
    const isUsed = this.station.isUsed(name, robot);
    use.checked = isUsed;
    const cells = { seen: cell(), gated: cell(), late: cell(), nis: cell(), consistency: element('td'), last: element('td', { class: 'last' }) };
    const line = element('tr', {},
      element('th', { scope: 'row' }, element('label', {}, radio, ` ${name}`)),
      cells.seen, cells.gated, cells.late, cells.nis, cells.consistency, cells.last, element('td', {}, use));
    this.table.append(line);
    const row = { line, radio, use, isUsed, ...cells };
    this.rows.set(source.sensor, row);
    return row;
  }

  async #switch(sensor, on) {
    const isTaken = await this.station.commandRobot({ command: 'switch-source', sensor: this.station.idOf(sensor), on });
    const row = this.rows.get(sensor);
    if (!isTaken && row) row.use.checked = row.isUsed;
  }

  // A source may be switched from elsewhere as well. Only what is news moves a box: what is told once a second may be older than a click.
  #showSwitches(robot) {
    const told = `${robot?.id} ${robot?.switchesTold} ${this.station.switchesTold}`;
    if (this.switchesShown === told) return;
    this.switchesShown = told;
    const isAnother = this.robotId !== robot?.id;
    this.robotId = robot?.id;
    for (const [sensor, row] of this.rows) {
      const isUsed = this.station.isUsed(sensor, robot);
      if (isAnother || isUsed !== row.isUsed) row.use.checked = isUsed;
      row.isUsed = isUsed;
      row.use.disabled = this.station.idOf(sensor) === undefined;
    }
  }

  #choose(sensor) {
    this.chosen = sensor;
    this.station.redraw();
  }

  // Charts are made anew when another source is chosen, or another number of components turns up.
  #chartsFor(source, robotId) {
    const components = componentsOf(source);
    const shape = `${robotId}|${source.sensor}|${components.length}`;
    if (shape === this.shape) return;
    this.shape = shape;
    for (const { chart, figure } of this.charts) {
      chart.remove();
      figure.remove();
    }
    const name = source.sensor;
    this.charts = components.map(([text, unit], index) => ({ index, ...this.#innovationChart(name, text, unit) }));
    this.charts.push({ index: -1, ...this.#nisChart(name) });
  }

  #innovationChart(name, text, unit) {
    const figure = element('figure', {}, element('figcaption', { text: `${name}, ${text}: observed − predicted, ${unit === 'rad' ? '°' : 'mm'}, 2 σ` }));
    this.host.append(figure);
    const kept = buffers(5);
    const chart = new Chart(figure, {
      label: `Innovations of ${name}, ${text}, with their band of two sigma`,
      lines: [
        { label: '+2 sigma', colour: 'ellipse', hidden: true },
        { label: '-2 sigma', colour: 'ellipse', hidden: true },
        { label: 'used', colour: 'estimate', mark: 'dot' },
        { label: 'gated', colour: 'gated', mark: 'cross' },
      ],
      bands: [[1, 2]],
      say: ([band, , used], row) => `${said(!Number.isNaN(used), kept[TRUE_VALUE][row], unit === 'rad' ? '°' : ' mm')}, 2 σ ${compact(band)}`,
      height: 130,
    });
    return { chart, figure, scale: unit === 'rad' ? 180 / Math.PI : 1000, buffers: kept };
  }

  #nisChart(name) {
    const figure = element('figure', {}, element('figcaption', { text: `${name}: NIS, 95 % (chi-square)` }));
    this.host.append(figure);
    const kept = buffers(5);
    const chart = new Chart(figure, {
      label: `Normalised innovation squared of ${name} with its chi-square band`,
      lines: [
        { label: '97.5 %', colour: 'ellipse', hidden: true },
        { label: '2.5 %', colour: 'ellipse', hidden: true },
        { label: 'used', colour: 'estimate', mark: 'dot' },
        { label: 'gated', colour: 'gated', mark: 'cross' },
      ],
      bands: [[1, 2]],
      y: { isLog: true },
      say: ([most, least, used], row) => `${said(!Number.isNaN(used), kept[TRUE_VALUE][row], '')}, band ${compact(least)} to ${compact(most)}`,
      height: 130,
    });
    return { chart, figure, scale: 1, buffers: kept };
  }

  #drawCharts(source) {
    const { track } = source;
    const { from_s, to_s } = timeAxis.span;
    const shown = track.shown(from_s, to_s, MOST_POINTS);
    for (const { chart, index, scale, buffers: columns } of this.charts) {
      const rows = index < 0 ? fillNis(columns, track, shown) : fillInnovation(columns, track, shown, { index, scale });
      if (index < 0) chart.range = NIS_RANGE;
      else chart.range = clampTo(bandRange(columns[1], rows), columns, rows);
      chart.draw(columns.slice(0, TRUE_VALUE).map((column) => column.subarray(0, rows)));
    }
  }
}

function said(isUsed, value, unit) {
  return `${isUsed ? 'used' : 'gated'} ${compact(value)}${unit}`;
}

function cell() {
  return element('td', { class: 'number' });
}

function buffers(lines) {
  // The first and the last bucket may lie partly outside of the span.
  return Array.from({ length: lines + 1 }, () => new Float64Array(MOST_POINTS + 64));
}

function firstWithNis(sources) {
  let first = null;
  for (const source of sources.values()) {
    if (source.kind === 'fix') return source;
    if (!first && source.track.length > 0 && !Number.isNaN(source.track.columns.nis[source.track.end - 1])) first = source;
  }
  return first ?? sources.values().next().value ?? null;
}

function componentsOf(source) {
  const { track } = source;
  let most = 0;
  for (let row = Math.max(track.begin, track.end - 20); row < track.end; row += 1) most = Math.max(most, track.columns.dof[row] || 0);
  const known = COMPONENTS.get(source.kind) ?? [];
  return Array.from({ length: Math.min(3, most) }, (_, index) => known[index] ?? [`component ${index + 1}`, 'm']);
}

function fillInnovation(columns, track, rows, { index, scale }) {
  const values = track.columns[`innovation${index}`];
  const sigmas = track.columns[`sigma${index}`];
  return fill(columns, track, rows, (at, row) => {
    const value = scale * values[row];
    const isGated = isRefused(track.columns.mark[row]);
    columns[1][at] = 2 * scale * sigmas[row];
    columns[2][at] = -2 * scale * sigmas[row];
    columns[3][at] = isGated ? NaN : value;
    columns[4][at] = isGated ? value : NaN;
    columns[TRUE_VALUE][at] = value;
  });
}

function fillNis(columns, track, rows) {
  return fill(columns, track, rows, (at, row) => {
    const band = nisBand(track.columns.dof[row]);
    const nis = Math.min(NIS_MOST, Math.max(NIS_FLOOR, track.columns.nis[row]));
    const isGated = isRefused(track.columns.mark[row]);
    columns[1][at] = band ? band[1] : NaN;
    columns[2][at] = band ? Math.max(NIS_FLOOR, band[0]) : NaN;
    columns[3][at] = isGated ? NaN : nis;
    columns[4][at] = isGated ? nis : NaN;
    columns[TRUE_VALUE][at] = track.columns.nis[row];
  });
}

function fill(columns, track, rows, set) {
  const { t_s, nis } = track.columns;
  let at = 0;
  for (const row of rows) {
    if (Number.isNaN(nis[row])) continue;
    columns[0][at] = t_s[row];
    set(at, row);
    at += 1;
  }
  return at;
}

// A range to both sides of zero in which the widest band takes its share; it goes in steps and does not tremble.
function bandRange(upper, rows) {
  let widest = 0;
  for (let at = 0; at < rows; at += 1) if (upper[at] > widest) widest = upper[at];
  const top = widest > 0 ? roundUp(widest / BAND_SHARE, RANGE_STEPS) : 1;
  return [-top, top];
}

// What lies beyond the range is drawn at its edge: one outlier shall not squeeze all others into a line.
function clampTo(range, columns, rows) {
  for (const values of [columns[3], columns[4]]) {
    for (let at = 0; at < rows; at += 1) {
      if (values[at] > EDGE * range[1]) values[at] = EDGE * range[1];
      else if (values[at] < EDGE * range[0]) values[at] = EDGE * range[0];
    }
  }
  return range;
}
