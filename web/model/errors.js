// How far estimate and odometry are from the truth of a simulated robot.
//
// Truth and estimates have stamps of their own, up to a period apart, in which a robot goes several millimetres: truth is interpolated to
// the instant of each estimate.

import { Track } from './track.js';

export class Errors {
  constructor(capacity) {
    this.track = new Track(['estimate_m', 'odometry_m', 'claim_m'], capacity);
    this.scored_s = -Infinity;
  }

  /** Scores the estimates that have truth on both sides and were not scored yet. */
  update(truth, estimates) {
    const times = estimates.columns.t_s;
    let row = estimates.rowAfter(this.scored_s);
    for (; row < estimates.end; row += 1) {
      const after = truth.rowAt(times[row]);
      if (after >= truth.end) return;
      this.scored_s = times[row];
      if (after > truth.begin) this.#score(truth, after, estimates, row);
    }
  }

  #score(truth, after, estimates, row) {
    const t_s = estimates.columns.t_s[row];
    const { x_m, y_m, odometry_x_m, odometry_y_m } = truth.columns;
    const part = fraction(truth.columns.t_s[after - 1], truth.columns.t_s[after], t_s);
    const between = (column) => column[after - 1] + part * (column[after] - column[after - 1]);
    const trueX_m = between(x_m);
    const trueY_m = between(y_m);
    this.track.append({
      t_s,
      estimate_m: Math.hypot(estimates.columns.x_m[row] - trueX_m, estimates.columns.y_m[row] - trueY_m),
      odometry_m: Math.hypot(between(odometry_x_m) - trueX_m, between(odometry_y_m) - trueY_m),
      claim_m: estimates.columns.major_m[row],
    });
  }

  /** Root mean square of a column over the last second before a time: what the headline says. NaN without samples. */
  recent(name, until_s) {
    const to = this.track.rowAfter(until_s);
    const from = this.track.rowAt(until_s - 1);
    const values = this.track.columns[name];
    let sum = 0;
    let count = 0;
    for (let row = from; row < to; row += 1) {
      if (Number.isNaN(values[row])) continue;
      sum += values[row] * values[row];
      count += 1;
    }
    return count > 0 ? Math.sqrt(sum / count) : NaN;
  }
}

function fraction(from, to, at) {
  return to > from ? (at - from) / (to - from) : 0;
}
