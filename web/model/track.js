// A bounded table of samples over time: one Float64Array per column, sorted by `t_s`.
//
// The newest `capacity` samples are kept. Columns grow to twice as much as that, so that a window is always one contiguous piece that a chart
// takes as it is; when the end is reached, the kept half moves to the front. Nothing is allocated per sample: columns double, so that a class of
// robots with short tracks costs little.
//
// A track with `peaks` keeps the whole run in the same room: its newest `capacity` samples in full, of older ones the peaks of these columns.

import { bucketWidth_s, peakRows } from './peaks.js';

// A late fix stands a few seconds behind others of its sensor: at 50 Hz and 3 s of history that is 150 rows.
const MOST_ROWS_TO_MOVE = 256;
const FIRST_ROWS = 256;

export class Track {
  /** @param {string[]} names columns besides `t_s`. @param {number} capacity samples that are kept in full. @param {?string[]} peaks */
  constructor(names, capacity, peaks = null) {
    this.names = ['t_s', ...names];
    this.capacity = capacity;
    this.peaks = peaks;
    /** Samples before `full_s` were thinned to buckets of `coarse_s`. */
    this.full_s = -Infinity;
    this.coarse_s = 0;
    this.columns = {};
    this.rows = Math.min(FIRST_ROWS, 2 * capacity);
    for (const name of this.names) this.columns[name] = new Float64Array(this.rows);
    this.begin = 0;
    this.end = 0;
    this.revision = 0;
  }

  get length() {
    return this.end - this.begin;
  }

  /** Adds a sample; what is not a finite number becomes NaN. Says whether it was taken: without a time it is not. */
  append(sample) {
    const t_s = sample.t_s;
    if (typeof t_s !== 'number' || !Number.isFinite(t_s)) return false;
    if (this.end === this.rows) this.#makeRoom();
    const row = this.#rowFor(t_s);
    for (const name of this.names) this.columns[name][row] = numberOf(sample[name]);
    this.end += 1;
    if (!this.peaks && this.length > this.capacity) this.begin += 1;
    this.revision += 1;
    return true;
  }

  clear() {
    this.begin = 0;
    this.end = 0;
    this.revision += 1;
  }

  /** The mean time between two samples that are kept in full; 0 without two. Live it is short; of a long recording only every so many-th is kept. */
  spacing_s() {
    const first = Math.max(this.begin, this.end - this.capacity);
    if (this.end - first < 2) return 0;
    return (this.columns.t_s[this.end - 1] - this.columns.t_s[first]) / (this.end - first - 1);
  }

  /** First row at or after a time; `end` when there is none. */
  rowAt(t_s) {
    const times = this.columns.t_s;
    let low = this.begin;
    let high = this.end;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] < t_s) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** Last row at or before a time; -1 when there is none. */
  rowUntil(t_s) {
    const after = this.rowAfter(t_s);
    return after > this.begin ? after - 1 : -1;
  }

  /** First row after a time. */
  rowAfter(t_s) {
    let row = this.rowAt(t_s);
    const times = this.columns.t_s;
    while (row < this.end && times[row] <= t_s) row += 1;
    return row;
  }

  /** First row from `from` on from which a column has the value of the row before `to`. */
  sameFrom(name, from, to) {
    const values = this.columns[name];
    let row = to - 1;
    while (row > from && Object.is(values[row - 1], values[to - 1])) row -= 1;
    return Math.max(row, from);
  }

  /** The rows of a span of time that a chart shows: all if they are no more than `most`, else the peaks of so many buckets. */
  shown(from_s, to_s, most) {
    const [from, to] = [this.rowAt(from_s), this.rowAfter(to_s)];
    if (to - from <= most || !this.peaks) return Array.from({ length: to - from }, (_, index) => from + index);
    return peakRows(this.columns, this.peaks, from, to, bucketWidth_s(to_s - from_s, most / (2 * this.peaks.length + 1)));
  }

  #makeRoom() {
    if (this.rows === 2 * this.capacity) {
      if (this.peaks) this.#thin();
      else this.#moveToFront();
      return;
    }
    this.rows = Math.min(2 * this.rows, 2 * this.capacity);
    for (const name of this.names) {
      const longer = new Float64Array(this.rows);
      longer.set(this.columns[name]);
      this.columns[name] = longer;
    }
  }

  // What is older than the newest `capacity` samples shall take half as much room as they.
  #thin() {
    const times = this.columns.t_s;
    const full = this.end - this.capacity;
    this.full_s = times[full];
    this.coarse_s = bucketWidth_s(times[full] - times[this.begin], this.capacity / 2 / (2 * this.peaks.length + 1));
    const rows = peakRows(this.columns, this.peaks, this.begin, full, this.coarse_s);
    for (const name of this.names) {
      const values = this.columns[name];
      rows.forEach((row, at) => { values[at] = values[row]; });
      values.copyWithin(rows.length, full, this.end);
    }
    this.begin = 0;
    this.end = rows.length + this.capacity;
  }

  #moveToFront() {
    for (const name of this.names) this.columns[name].copyWithin(0, this.begin, this.end);
    this.end -= this.begin;
    this.begin = 0;
  }

  // Makes room for a sample among the newest rows and says where.
  #rowFor(t_s) {
    const times = this.columns.t_s;
    let row = this.end;
    const first = Math.max(this.begin, this.end - MOST_ROWS_TO_MOVE);
    while (row > first && times[row - 1] > t_s) row -= 1;
    if (row < this.end) {
      for (const name of this.names) this.columns[name].copyWithin(row + 1, row, this.end);
    }
    return row;
  }
}

/** A finite number, 0 or 1 for a boolean, else NaN. */
export function numberOf(value) {
  if (typeof value === 'number') return Number.isFinite(value) ? value : NaN;
  if (typeof value === 'boolean') return value ? 1 : 0;
  return NaN;
}
