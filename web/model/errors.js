// How far estimate and odometry are from the truth of a simulated robot, as the station says.
//
// It holds each estimate against the truth of the same instant of the robot's clock. By the host's clock, which is all that a page has, the two
// lie up to the link's delay apart, in which a robot goes several millimetres: nothing is worked out here.

import { Track } from './track.js';

const RECENT_S = 1;
// Of a long recording samples may be further apart.
const RECENT_SPACINGS = 4;

const COLUMNS = ['estimate_m', 'odometry_m', 'claim_m'];

export class Errors {
  constructor(capacity) {
    this.track = new Track(COLUMNS, capacity, COLUMNS);
  }

  /** Takes what the station says of an estimate; without a distance of the estimate none came for a while. */
  take(score) {
    this.track.append(score);
  }

  /** Root mean square of a column over the last second before a time: what the headline says. NaN without samples. */
  recent(name, until_s) {
    const to = this.track.rowAfter(until_s);
    const from = this.track.rowAt(until_s - Math.max(RECENT_S, RECENT_SPACINGS * this.track.spacing_s()));
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
