// What is kept of one robot: tracks of its estimates, fixes, fusion records and learned numbers. All bounded.

import { LATE_FROM_S, markOf } from './marks.js';
import { Track } from './track.js';

export const ESTIMATE_COLUMNS = [
  'x_m', 'y_m', 'heading_rad', 'major_m', 'minor_m', 'axis_rad', 'heading_sigma_rad',
  'forward_m_per_s', 'turn_rad_per_s', 'reset_counter', 'is_dead_reckoning', 'fix_age_s',
];
const FUSION_COLUMNS = ['nis', 'dof', 'mark', 'is_slip', 'innovation0', 'innovation1', 'innovation2', 'sigma0', 'sigma1', 'sigma2'];

// 80 s at the 50 Hz at which a station sends; the map shows 60 s.
export const LIVE_CAPACITY = 4096;
// A robot has a handful of each; more than this is not a robot but nonsense.
const MOST_SENSORS = 32;
const MOST_CALIBRATED = 64;
// Learned numbers change slowly: 1024 samples at this distance are five minutes.
const CALIBRATION_EVERY_S = 0.3;
const CALIBRATION_CAPACITY = 1024;

export class Robot {
  constructor(id, capacity = LIVE_CAPACITY) {
    this.id = id;
    this.capacity = capacity;
    this.estimates = new Track(ESTIMATE_COLUMNS, capacity);
    this.fixes = new Track(['x_m', 'y_m', 'heading_rad', 'mark'], Math.max(1024, capacity / 2));
    /** sensor -> { sensor, kind, track, counts, lastVerdict } */
    this.sources = new Map();
    /** name -> { name, unit, value, sigma, isLearned, track } */
    this.calibration = new Map();
  }

  /** Takes what a frame or a history says of this robot; anything that is not as agreed is left out. */
  apply(part, now_s) {
    for (const estimate of list(part.estimates)) this.estimates.append(estimate);
    for (const fix of list(part.fixes)) this.#fix(fix);
    for (const record of list(part.fusion)) this.#record(record);
    for (const entry of list(part.calibration)) this.#learned(entry, now_s);
  }

  #fix(fix) {
    const mark = markOf(fix.verdict, fix.lag_s);
    this.fixes.append({ t_s: fix.t_s, x_m: fix.x_m, y_m: fix.y_m, heading_rad: fix.heading_rad, mark });
  }

  #record(record) {
    const source = this.#source(record);
    if (!source) return;
    const innovation = list(record.innovation);
    const sigma = list(record.sigma);
    const taken = source.track.append({
      t_s: record.t_s,
      nis: record.dof > 0 ? record.nis : NaN,
      dof: record.dof,
      mark: markOf(record.verdict, record.lag_s),
      is_slip: record.verdict === 'slip',
      innovation0: innovation[0], innovation1: innovation[1], innovation2: innovation[2],
      sigma0: sigma[0], sigma1: sigma[1], sigma2: sigma[2],
    });
    if (!taken) return;
    source.lastVerdict = String(record.verdict).slice(0, 40);
    source.total += 1;
    if (record.verdict === 'gated') source.gated += 1;
    if (record.lag_s >= LATE_FROM_S) source.late += 1;
  }

  #source(record) {
    const sensor = String(record.sensor).slice(0, 40);
    let source = this.sources.get(sensor);
    if (!source && this.sources.size < MOST_SENSORS) {
      source = {
        sensor,
        kind: String(record.kind).slice(0, 40),
        track: new Track(FUSION_COLUMNS, this.capacity / 2),
        lastVerdict: '', total: 0, gated: 0, late: 0,
      };
      this.sources.set(sensor, source);
    }
    return source;
  }

  #learned(entry, now_s) {
    const name = String(entry.name).slice(0, 60);
    let known = this.calibration.get(name);
    if (!known) {
      if (this.calibration.size >= MOST_CALIBRATED) return;
      known = { name, unit: String(entry.unit ?? '').slice(0, 20), value: NaN, sigma: NaN, isLearned: false, last_s: -Infinity,
        track: new Track(['value', 'sigma'], CALIBRATION_CAPACITY) };
      this.calibration.set(name, known);
    }
    const t_s = Number.isFinite(entry.t_s) ? entry.t_s : now_s;
    known.value = entry.value;
    known.sigma = entry.sigma;
    // A sigma of zero: taken as given and not estimated.
    known.isLearned ||= entry.sigma > 0;
    if (t_s - known.last_s < CALIBRATION_EVERY_S) return;
    known.last_s = t_s;
    known.track.append({ t_s, value: entry.value, sigma: entry.sigma });
  }
}

/** The value if it is an array, else an empty one: what comes from a wire may be anything. */
export function list(value) {
  return Array.isArray(value) ? value : NOTHING;
}

const NOTHING = Object.freeze([]);
