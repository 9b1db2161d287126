// Charts over time on uPlot: lines, bands and marks, in the page's colours. All show the span of one time axis and point at the same instant.

import { timeAxis } from '../model/time_axis.js';
import { element, setText } from './dom.js';
import { clockTime, compact, shortTime } from './format.js';
import { palette } from './palette.js';

const FONT = '11px system-ui, sans-serif';
const HEIGHT_PX = 150;
// Steps of the time axis, in seconds.
const TIME_STEPS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200];
// From this span on times are minutes and seconds.
const CLOCK_FROM_S = 150;
// The cursor says nothing of an instant from which the nearest sample is further than this, or than this share of the span.
const NEAREST_S = 1;
const NEAREST_SHARE = 0.01;

/**
 * @typedef {{label: string, colour: string, dash?: number[], width?: number, mark?: 'dot'|'cross'|'ring', hidden?: boolean}} Line
 *   `colour` is a name in the palette; a line with a mark has no line, one that is hidden only bounds a band.
 * @typedef {{lines: Line[], bands?: [number, number][], y?: {isLog?: boolean, format?: (value: number) => string}, height?: number, label: string,
 *   unit?: string, say?: (values: number[], row: number) => string, readout?: HTMLElement, isSmall?: boolean}} Shape
 *   `unit` and `say` are for the values at the cursor, one for each line; `readout` is where they stand, else in the chart. A small one has no axes.
 */

/** A chart in `host`. `draw(columns)` takes times and one array for each line, within the span of the time axis; `range` is what y shows. */
export class Chart {
  /** @param {Shape} shape */
  constructor(host, shape) {
    this.host = element('div', { class: 'chart', role: 'img', 'aria-label': shape.label });
    host.append(this.host);
    this.shape = shape;
    this.window = [0, 1];
    this.now_s = Infinity;
    this.isHeld = false;
    this.range = shape.y?.isLog ? [1e-3, 1] : [-1, 1];
    this.height = shape.height ?? HEIGHT_PX;
    this.plot = new globalThis.uPlot(this.#options(shape), shape.lines.reduce((data) => [...data, []], [[]]), this.host);
    this.readout = shape.readout ?? element('p', { class: 'at' });
    if (!shape.readout) this.host.append(this.readout);
    const { over } = this.plot;
    over.addEventListener('mousemove', (event) => timeAxis.point(this.plot.posToVal(event.clientX - over.getBoundingClientRect().left, 'x')));
    over.addEventListener('mouseleave', () => timeAxis.point(NaN));
    over.addEventListener('mousedown', () => this.#hold());
    this.sizes = new ResizeObserver(() => this.#fit());
    this.sizes.observe(this.host);
  }

  draw(columns) {
    const { from_s, to_s, until_s } = timeAxis.span;
    this.window[0] = from_s;
    this.window[1] = to_s;
    this.now_s = until_s;
    this.plot.setData(columns, true);
    this.#pointAt(timeAxis.cursor_s);
  }

  // The span may have moved on since somebody pointed: the cursor stays with its instant.
  #pointAt(t_s) {
    const isShown = t_s >= this.window[0] && t_s <= this.window[1];
    const left = isShown ? this.plot.valToPos(t_s, 'x') : -10;
    if (isShown || this.plot.cursor.left >= 0) this.plot.setCursor({ left, top: isShown ? 0 : -10 }, false);
    setText(this.readout, isShown ? this.#said(t_s) : '');
  }

  // The values at an instant: those of the nearest sample.
  #said(t_s) {
    const times = this.plot.data[0];
    const row = nearest(times, t_s);
    const most_s = Math.max(NEAREST_S, NEAREST_SHARE * (this.window[1] - this.window[0]));
    if (row < 0 || Math.abs(times[row] - t_s) > most_s) return `${clockTime(t_s)}  no data`;
    const values = this.shape.lines.map((_, index) => this.plot.data[index + 1][row]);
    return `${clockTime(t_s)}  ${this.shape.say ? this.shape.say(values, row) : this.#listed(values)}`;
  }

  #listed(values) {
    const format = this.shape.y?.isLog && this.shape.y.format ? this.shape.y.format : (value) => [compact(value), this.shape.unit].filter(Boolean).join(' ');
    const isSaid = (value, index) => !this.shape.lines[index].hidden && Number.isFinite(value);
    return values.map((value, index) => (isSaid(value, index) ? `${this.shape.lines[index].label} ${format(value)}` : '')).filter(Boolean).join(', ');
  }

  remove() {
    this.sizes.disconnect();
    this.plot.destroy();
    this.host.remove();
  }

  #hold() {
    this.isHeld = true;
    timeAxis.hold(true);
    addEventListener('mouseup', () => {
      this.isHeld = false;
      timeAxis.hold(false);
    }, { once: true });
  }

  // All charts are told of a piece that somebody chose in one of them.
  #chosen(plot) {
    const { left, width } = plot.select;
    if (width <= 0) return;
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    if (this.isHeld) timeAxis.zoom(plot.posToVal(left, 'x'), plot.posToVal(left + width, 'x'));
  }

  // In a replay the instant that all else shows, where the chart goes on after it.
  #markNow(plot) {
    if (!(this.now_s > this.window[0] && this.now_s < this.window[1])) return;
    const x = Math.round(plot.valToPos(this.now_s, 'x', true));
    plot.ctx.fillStyle = palette.faint;
    plot.ctx.fillRect(x, plot.bbox.top, Math.max(1, globalThis.devicePixelRatio || 1), plot.bbox.height);
  }

  #fit() {
    const width = this.host.clientWidth;
    if (width > 0 && width !== this.plot.width) this.plot.setSize({ width, height: this.height });
  }

  #options(shape) {
    const y = shape.y ?? {};
    return {
      width: Math.max(200, this.host.clientWidth),
      height: this.height,
      legend: { show: false },
      cursor: {
        y: false,
        points: { show: false },
        drag: { x: true, y: false, setScale: false },
        sync: { key: 'time', scales: ['x', null] },
        bind: { dblclick: () => () => { timeAxis.show(timeAxis.base); return null; } },
      },
      hooks: { setSelect: [(plot) => this.#chosen(plot)], draw: [(plot) => this.#markNow(plot)] },
      padding: shape.isSmall ? [2, 0, 2, 0] : [8, 12, 0, 0],
      scales: {
        x: { time: false, range: () => this.window },
        y: { distr: y.isLog ? 3 : 1, range: () => this.range },
      },
      axes: shape.isSmall ? [{ show: false }, { show: false }] : [axisOfTime(), axisOfValues(y)],
      series: [{}, ...shape.lines.map(series)],
      bands: (shape.bands ?? []).map((pair) => ({ series: pair, fill: () => translucent(palette.ellipse) })),
    };
  }
}

// The session begins at zero: there is nothing before it to be labelled.
function axisOfTime() {
  const label = (tick, span_s) => (span_s < CLOCK_FROM_S ? `${Number(tick.toFixed(2))} s` : shortTime(tick));
  return axis({ size: 26, space: 60, incrs: TIME_STEPS, values: ({ scales: { x } }, ticks) => ticks.map((tick) => (tick < 0 ? '' : label(tick, x.max - x.min))) });
}

function axisOfValues({ isLog, format = String }) {
  const made = axis({ size: 52, space: 26, values: (_, ticks) => ticks.map((tick) => (tick === null ? '' : format(tick))) });
  if (!isLog) return made;
  return { ...made, splits: (plot) => decades(plot.scales.y.min, plot.scales.y.max), filter: (_, splits) => splits };
}

// The row of the sample nearest to a time; -1 without any.
function nearest(times, t_s) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < t_s) low = middle + 1;
    else high = middle;
  }
  return low > 0 && (low === times.length || t_s - times[low - 1] < times[low] - t_s) ? low - 1 : low < times.length ? low : -1;
}

// Every decade of a range, or every second one when there are many.
function decades(low, high) {
  const from = Math.round(Math.log10(low));
  const count = Math.round(Math.log10(high)) - from;
  const step = count > 4 ? 2 : 1;
  return Array.from({ length: Math.floor(count / step) + 1 }, (_, index) => Number((10 ** (from + step * index)).toPrecision(1)));
}

function axis(extra) {
  return {
    font: FONT,
    stroke: () => palette.faint,
    grid: { stroke: () => palette.grid, width: 1 },
    ticks: { show: false },
    ...extra,
  };
}

function series(line) {
  const colour = () => palette[line.colour];
  if (line.mark) return { label: line.label, stroke: colour, width: 0, paths: marks(line.mark, colour), points: { show: false } };
  return { label: line.label, stroke: colour, width: line.width ?? (line.hidden ? 0.6 : 1.5), dash: line.dash, points: { show: false }, spanGaps: false };
}

const RADIUS_PX = 2.2;

// Draws the marks of a series itself: uPlot's own points know circles only.
function marks(shape, colour) {
  return (plot, seriesIndex, from, to) => {
    const context = plot.ctx;
    const scale = globalThis.devicePixelRatio || 1;
    const radius = RADIUS_PX * scale * (shape === 'dot' ? 0.8 : 1.4);
    const times = plot.data[0];
    const values = plot.data[seriesIndex];
    context.save();
    context.beginPath();
    context.rect(plot.bbox.left, plot.bbox.top, plot.bbox.width, plot.bbox.height);
    context.clip();
    context.beginPath();
    for (let row = from; row <= to; row += 1) {
      const value = values[row];
      if (value === null || value === undefined || Number.isNaN(value)) continue;
      addMark(context, shape, plot.valToPos(times[row], 'x', true), plot.valToPos(value, 'y', true), radius);
    }
    paint(context, shape, colour(), scale);
    context.restore();
    return null;
  };
}

function addMark(context, shape, x, y, radius) {
  if (shape === 'cross') {
    context.moveTo(x - radius, y - radius);
    context.lineTo(x + radius, y + radius);
    context.moveTo(x - radius, y + radius);
    context.lineTo(x + radius, y - radius);
    return;
  }
  context.moveTo(x + radius, y);
  context.arc(x, y, radius, 0, 2 * Math.PI);
}

function paint(context, shape, colour, scale) {
  if (shape === 'dot') {
    context.fillStyle = colour;
    context.fill();
    return;
  }
  context.strokeStyle = colour;
  context.lineWidth = 1.4 * scale;
  context.stroke();
}

/** The next of some steps, 1, 2 or 5 unless told, times a power of ten. */
export function roundUp(size, steps = [1, 2, 5]) {
  const power = 10 ** Math.floor(Math.log10(size));
  for (const step of steps) if (size <= step * power) return step * power;
  return 10 * power;
}

/** A colour `#rrggbb` at the opacity of bands. */
export function translucent(colour) {
  return `${colour}33`;
}
