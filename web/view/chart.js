// Charts over time on uPlot: a window of seconds, lines, bands and marks, in the page's colours.

import { element } from './dom.js';
import { palette } from './palette.js';

const FONT = '11px system-ui, sans-serif';
const HEIGHT_PX = 150;

/**
 * @typedef {{label: string, colour: string, dash?: number[], width?: number, mark?: 'dot'|'cross'|'ring', hidden?: boolean}} Line
 *   `colour` is a name in the palette; a line with a mark has no line, one that is hidden only bounds a band.
 */

/** A chart in `host`. `draw(columns, from_s, to_s)` takes times and one array for each line; `range` is what y shows. */
export class Chart {
  /** @param {{lines: Line[], bands?: [number, number][], y?: {isLog?: boolean, format?: (value: number) => string}, height?: number, label: string}} shape */
  constructor(host, shape) {
    this.host = element('div', { class: 'chart', role: 'img', 'aria-label': shape.label });
    host.append(this.host);
    this.window = [0, 1];
    this.range = shape.y?.isLog ? [1e-3, 1] : [-1, 1];
    this.height = shape.height ?? HEIGHT_PX;
    this.plot = new globalThis.uPlot(this.#options(shape), shape.lines.reduce((data) => [...data, []], [[]]), this.host);
    this.sizes = new ResizeObserver(() => this.#fit());
    this.sizes.observe(this.host);
  }

  draw(columns, from_s, to_s) {
    this.window[0] = from_s;
    this.window[1] = to_s;
    this.plot.setData(columns, true);
  }

  remove() {
    this.sizes.disconnect();
    this.plot.destroy();
    this.host.remove();
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
      cursor: { show: false },
      padding: [8, 6, 0, 0],
      scales: {
        x: { time: false, range: () => this.window },
        y: { distr: y.isLog ? 3 : 1, range: () => this.range },
      },
      axes: [timeAxis(), valueAxis(y)],
      series: [{}, ...shape.lines.map(series)],
      bands: (shape.bands ?? []).map((pair) => ({ series: pair, fill: () => translucent(palette.ellipse) })),
    };
  }
}

// The session begins at zero: there is nothing before it to be labelled.
function timeAxis() {
  return axis({ size: 26, space: 60, values: (_, ticks) => ticks.map((tick) => (tick < 0 ? '' : `${tick} s`)) });
}

function valueAxis({ isLog, format = String }) {
  const made = axis({ size: 52, space: 26, values: (_, ticks) => ticks.map((tick) => (tick === null ? '' : format(tick))) });
  if (!isLog) return made;
  return { ...made, splits: (plot) => decades(plot.scales.y.min, plot.scales.y.max), filter: (_, splits) => splits };
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
