// A quantity over time: readings with what became of them, and what a filter makes of them; see QuantityPoint of the station.

import { isNotUsed, markOf } from './marks.js';
import { silence_s } from './silence.js';
import { Track } from './track.js';
import { Words } from './words.js';

const COLUMNS = ['reading', 'mark', 'verdict', 'estimate', 'bound', 'rate', 'steps', 'predicted'];
const PEAKS = ['reading', 'estimate', 'rate'];
// A reading is looked for in so many points before the last one; steps without a reading have none.
const MOST_STEPS_BACK = 1000;

export class Quantity {
  #verdicts = new Words();

  constructor({ name, kind, unit }, capacity) {
    /** The thermometer; empty for the quantity of the robot's own filter. */
    this.name = name;
    this.kind = kind;
    this.unit = unit;
    this.track = new Track(COLUMNS, capacity, PEAKS);
    /** Whether it ever changed by itself: a thermometer's end does not. */
    this.hasRate = false;
  }

  take(point) {
    const hasReading = Number.isFinite(point.reading);
    this.track.append({
      t_s: point.t_s, reading: point.reading, mark: hasReading ? markOf(point.verdict, 0) : NaN, verdict: hasReading ? this.#verdicts.number(point.verdict) : NaN,
      estimate: point.estimate, bound: point.bound_95, rate: point.rate_per_s, steps: point.steps, predicted: point.predicted,
    });
    this.hasRate ||= Number.isFinite(point.rate_per_s) && point.rate_per_s !== 0;
  }

  /** How it stood at a time; null before the first point. */
  at(until_s) {
    const { columns } = this.track;
    const row = this.track.rowUntil(until_s);
    if (row < 0) return null;
    const read = this.#lastReading(row);
    return {
      t_s: columns.t_s[row],
      reading: read < 0 ? NaN : columns.reading[read],
      verdict: read < 0 ? '' : this.#verdicts.text(columns.verdict[read]),
      isRefused: read >= 0 && isNotUsed(columns.mark[read]),
      estimate: columns.estimate[row], bound: columns.bound[row], rate: columns.rate[row],
      steps: columns.steps[row], predicted: columns.predicted[row],
      silent_s: silence_s(this.track, until_s),
    };
  }

  #lastReading(from) {
    const { reading } = this.track.columns;
    const to = Math.max(this.track.begin, from - MOST_STEPS_BACK);
    for (let row = from; row >= to; row -= 1) if (!Number.isNaN(reading[row])) return row;
    return -1;
  }
}
