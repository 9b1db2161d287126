// Quantities over time: readings with what became of them, the estimate with its 95 % band, and its rate. Of the chosen robot's filter, if that
// knows one quantity, and of all thermometers.

import { isNotUsed } from '../model/marks.js';
import { hasChoice } from '../model/robot_list.js';
import { SILENT_FROM_S, SILENT_SPACINGS } from '../model/silence.js';
import { timeAxis } from '../model/time_axis.js';
import { Chart, roundUp } from '../view/chart.js';
import { element, scrolled, setText } from '../view/dom.js';
import { compact, fixed, withSigma } from '../view/format.js';

// More are listed but not drawn.
const MOST_CHARTS = 8;
// More points are thinned; a chart is some 400 pixels wide.
const MOST_POINTS = 1500;
// Of the whole height, at the edge: where marks beyond the chart stand.
const EDGE = 0.03;
// A band may take so many times the height of the lines.
const BAND_SHARE = 0.5;

const KINDS = new Map([
  ['wall_range', { title: 'distance to the wall', rate: 'velocity (negative towards the wall)', digits: 3 }],
  ['temperature', { title: 'temperature', rate: 'rate of the temperature', digits: 2 }],
]);

const STATE = { text: 'state', kind: 'state', title: 'whether it is still heard', read: ({ state }) => state };
const LAST = { text: 'last reading', kind: 'verdict', title: 'what became of the last reading', read: ({ now }) => now.verdict || '–' };

const FILTER_COLUMNS = [
  STATE,
  { text: 'reading', title: 'as the robot sent it', kind: 'number', read: ({ quantity, now }) => reading(quantity, now) },
  { text: 'estimate ± 95 %', title: 'what the filter makes of the readings', kind: 'number', read: ({ quantity, now }) => estimate(quantity, now) },
  { text: 'rate', title: 'change of the estimate', kind: 'number', read: ({ quantity, now }) => fixed(now.rate, 3, `${quantity.unit}/s`) },
  LAST,
  { text: 'predicted only', title: 'share of the steps so far whose reading was refused or did not come', kind: 'number', read: ({ now }) => share(now) },
];

const THERMOMETER_COLUMNS = [
  STATE,
  { text: 'shown', title: 'as the brick sent it', kind: 'number', read: ({ quantity, now }) => reading(quantity, now) },
  { text: 'predicted end ± 95 %', title: 'what it will show in the end', kind: 'number', read: ({ quantity, now }) => (Number.isNaN(now.estimate) ? 'cannot tell yet' : estimate(quantity, now)) },
  LAST,
  { text: 'refused', title: 'share of the readings so far that were not used', kind: 'number', read: ({ now }) => share(now) },
];

/** The quantity that the chosen robot's filter knows. */
export const quantity = {
  id: 'quantity',
  title: 'Estimated quantity',
  isOfRobot: true,
  isShown: ({ robot }) => Boolean(robot?.quantity),
  build: (body) => new QuantitiesPanel(body, {
    heading: 'quantity', columns: FILTER_COLUMNS, line: 'estimate',
    of: ({ robot }) => (robot?.quantity ? [{ robot, quantity: robot.quantity }] : []),
    nameOf: (quantity) => titleOf(quantity),
  }),
};

export const thermometers = {
  id: 'thermometers',
  title: 'Thermometers',
  isShown: ({ session }) => session.thermometers().length > 0,
  build: (body) => new QuantitiesPanel(body, {
    heading: 'thermometer', columns: THERMOMETER_COLUMNS, line: 'predicted end',
    of: ({ session }) => session.thermometers(),
    nameOf: (quantity, robot, isOneOfMany) => (isOneOfMany ? `${quantity.name} of ${robot.label}` : quantity.name),
  }),
};

/** A row of the table and its charts for each of some quantities. */
class QuantitiesPanel {
  constructor(body, { heading, columns, line, of, nameOf }) {
    this.columns = columns;
    this.line = line;
    this.of = of;
    this.nameOf = nameOf;
    /** Quantity -> its row and charts. */
    this.shown = new Map();
    this.table = element('tbody');
    this.charts = element('div', { class: 'charts' });
    // Not `rest`: that is what the page calls before another robot is chosen.
    this.limit = element('p', { class: 'note', text: `The first ${MOST_CHARTS} have charts.`, hidden: true });
    const head = columns.map(({ text, title, kind }) => element('th', { scope: 'col', class: kind, text, title }));
    body.append(
      scrolled(`Table of each ${heading}`, element('table', { class: 'quantities' },
        element('thead', {}, element('tr', {}, element('th', { scope: 'col', text: heading }), ...head)), this.table)),
      this.charts, this.limit,
      element('p', { class: 'note keys' },
        key('estimate', line), key('band', '95 % within'), key('used', 'reading used'), key('refused', 'reading refused')));
  }

  draw(view) {
    const wanted = this.of(view);
    const quantities = new Set(wanted.map((one) => one.quantity));
    for (const [known, shown] of this.shown) {
      if (quantities.has(known)) continue;
      shown.remove();
      this.shown.delete(known);
    }
    const isOneOfMany = new Set(wanted.map(({ robot }) => robot.id)).size > 1 || hasChoice(view.session);
    this.limit.hidden = wanted.length <= MOST_CHARTS;
    for (const { robot, quantity: one } of wanted) {
      const name = this.nameOf(one, robot, isOneOfMany);
      let shown = this.shown.get(one);
      if (!shown) {
        shown = new ShownQuantity(this, one, name);
        this.shown.set(one, shown);
      }
      shown.draw(robot, name, view);
    }
  }
}

class ShownQuantity {
  constructor(panel, one, name) {
    this.panel = panel;
    this.quantity = one;
    this.title = element('th', { scope: 'row', class: 'name' });
    this.cells = panel.columns.map(({ kind }) => element('td', { class: kind }));
    this.row = element('tr', {}, this.title, ...this.cells);
    panel.table.append(this.row);
    this.values = null;
    this.rates = null;
    /** Refused readings as they were, row by row of the chart. */
    this.refused = [];
    this.name = name;
    if (panel.shown.size < MOST_CHARTS) this.values = this.#valueChart(name);
  }

  draw(robot, name, { until_s, isReplay }) {
    const { quantity: one, panel } = this;
    const now = one.at(until_s);
    const state = stateOf(robot, now, isReplay);
    setText(this.title, name);
    this.row.dataset.state = state.kind;
    this.row.dataset.verdict = now?.isRefused ? 'refused' : 'used';
    panel.columns.forEach(({ read }, index) => setText(this.cells[index], now ? read({ quantity: one, now, state: state.text }) : '–'));
    if (!this.values) return;
    if (one.hasRate && !this.rates) this.rates = this.#rateChart(name);
    const { from_s, to_s } = timeAxis.span;
    const rows = one.track.shown(from_s, to_s, MOST_POINTS);
    const columns = columnsOf(one, rows);
    this.refused = [...columns[5]];
    this.values.chart.range = rangeOf(columns);
    clampMarks(columns[5], this.values.chart.range);
    this.values.chart.draw(columns);
    if (!this.rates) return;
    const rates = ratesOf(one, rows);
    this.rates.chart.range = aroundZero(rates[1]);
    this.rates.chart.draw(rates);
  }

  remove() {
    this.row.remove();
    for (const made of [this.values, this.rates]) {
      made?.chart.remove();
      made?.figure.remove();
    }
  }

  #valueChart(name) {
    const { unit } = this.quantity;
    return this.#chart(`${name}, ${unit}`, {
      label: `${name} over time in ${unit}: readings, ${this.panel.line} and its band of 95 per cent`,
      lines: [
        { label: '+95 %', colour: 'ellipse', hidden: true },
        { label: '-95 %', colour: 'ellipse', hidden: true },
        { label: this.panel.line, colour: 'estimate', width: 1.8 },
        { label: 'used', colour: 'accepted', mark: 'dot' },
        { label: 'refused', colour: 'gated', mark: 'cross' },
      ],
      bands: [[1, 2]],
      y: { format: compactTick },
      say: (values, row) => this.#said(values, row),
      height: 190,
    });
  }

  // A refused reading beyond the chart stands at its edge, but is said as it was.
  #said([upper, , value, used], row) {
    const refused = this.refused[row];
    const parts = [
      Number.isFinite(value) ? `${this.panel.line} ${withSigma(value, upper - value)}` : '',
      Number.isFinite(used) ? `used ${compact(used)}` : '', Number.isFinite(refused) ? `refused ${compact(refused)}` : '',
    ];
    return `${parts.filter(Boolean).join(', ')} ${this.quantity.unit}`;
  }

  #rateChart(name) {
    const { rate } = kindOf(this.quantity);
    const unit = `${this.quantity.unit}/s`;
    return this.#chart(`${rate}, ${unit}`, {
      label: `Rate of ${name} over time in ${unit}`,
      lines: [{ label: 'rate', colour: 'estimate', width: 1.8 }],
      unit,
      y: { format: compactTick },
      height: 190,
    });
  }

  #chart(caption, shape) {
    const figure = element('figure', {}, element('figcaption', { text: caption }));
    this.panel.charts.append(figure);
    return { chart: new Chart(figure, shape), figure };
  }
}

function key(kind, text) {
  return element('span', { class: `key ${kind}`, text });
}

function kindOf({ kind }) {
  return KINDS.get(kind) ?? { title: kind.replaceAll('_', ' '), rate: 'rate', digits: 3 };
}

function titleOf(one) {
  return kindOf(one).title;
}

function reading(one, now) {
  return fixed(now.reading, kindOf(one).digits, one.unit);
}

function estimate(one, now) {
  return withSigma(now.estimate, now.bound, one.unit);
}

function share({ steps, predicted }) {
  return steps > 0 ? `${fixed((100 * predicted) / steps, 0)} % of ${steps}` : '–';
}

function stateOf(robot, now, isReplay) {
  if (!now) return { kind: 'waiting', text: '–' };
  const since = now.silent_s > 0 ? ` for ${Math.floor(now.silent_s)} s` : '';
  if (robot.lost_s >= now.t_s) return { kind: 'lost', text: `lost${since}` };
  return since ? { kind: 'silent', text: `silent${since}` } : { kind: 'live', text: isReplay ? 'heard' : 'live' };
}

// Times, upper and lower end of the band, estimate, used and refused readings. uPlot ends a line at null, and draws on through what is undefined.
function columnsOf({ track, name }, rows) {
  const { t_s, reading: readings, mark, estimate: estimates, bound } = track.columns;
  const columns = [[], [], [], [], [], []];
  // Of several readings in one step only the last has the estimate; a thermometer without one is one whose end nobody can tell.
  const none = name === '' ? undefined : null;
  eachShown(track, rows, (row) => {
    const isKnown = !Number.isNaN(estimates[row]);
    const refused = isNotUsed(mark[row]);
    push(columns, [
      t_s[row],
      isKnown ? estimates[row] + bound[row] : none, isKnown ? estimates[row] - bound[row] : none, isKnown ? estimates[row] : none,
      refused || Number.isNaN(readings[row]) ? null : readings[row], refused ? readings[row] : null,
    ]);
  }, (gap_s) => push(columns, [gap_s, null, null, null, null, null]));
  return columns;
}

function ratesOf({ track }, rows) {
  const { t_s, rate } = track.columns;
  const columns = [[], []];
  eachShown(track, rows, (row) => push(columns, [t_s[row], Number.isNaN(rate[row]) ? undefined : rate[row]]), (gap_s) => push(columns, [gap_s, null]));
  return columns;
}

// Between two rows that are far apart there is a gap: nothing was heard. What was thinned has as much as two buckets between its rows.
function eachShown(track, rows, show, showGap) {
  const { t_s } = track.columns;
  const width_s = rows.length > 1 ? (t_s[rows.at(-1)] - t_s[rows[0]]) / rows.length : 0;
  const usual_s = Math.max(SILENT_FROM_S, SILENT_SPACINGS * track.spacing_s(), SILENT_SPACINGS * width_s);
  let last_s = NaN;
  for (const row of rows) {
    const most_s = last_s < track.full_s ? Math.max(usual_s, 2 * track.coarse_s) : usual_s;
    if (t_s[row] - last_s > most_s) showGap((last_s + t_s[row]) / 2);
    last_s = t_s[row];
    show(row);
  }
}

function push(columns, values) {
  values.forEach((value, index) => columns[index].push(value));
}

// Holds readings and estimate, and as much of the band as does not squeeze them; it goes in steps and does not tremble.
function rangeOf([, upper, lower, estimates, used, refused]) {
  let [low, high] = spanOf([used, estimates]);
  if (low > high) [low, high] = spanOf([refused]);
  if (low > high) return [0, 1];
  const room = BAND_SHARE * (high - low);
  const [bandLow, bandHigh] = spanOf([upper, lower]);
  if (bandLow <= bandHigh) [low, high] = [Math.min(low, Math.max(bandLow, low - room)), Math.max(high, Math.min(bandHigh, high + room))];
  const size = Math.max(high - low, 1e-2 * Math.abs(high), 1e-3);
  const step = roundUp(size / 10);
  return [step * Math.floor((low - 0.03 * size) / step), step * Math.ceil((high + 0.03 * size) / step)];
}

function aroundZero(rates) {
  const [low, high] = spanOf([rates]);
  const size = Math.max(Math.abs(low), Math.abs(high));
  if (!Number.isFinite(size) || size === 0) return [-1, 1];
  const step = roundUp(size / 4);
  return [step * Math.floor(Math.min(0, low) / step), step * Math.ceil(Math.max(0, high) / step)];
}

function spanOf(columns) {
  let [low, high] = [Infinity, -Infinity];
  for (const values of columns) {
    for (const value of values) {
      if (value === null || value === undefined) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  return [low, high];
}

function clampMarks(values, [low, high]) {
  const edge = EDGE * (high - low);
  values.forEach((value, index) => {
    if (value !== null) values[index] = Math.min(high - edge, Math.max(low + edge, value));
  });
}

function compactTick(value) {
  return String(Number(value.toPrecision(6)));
}
