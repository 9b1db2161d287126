// What is kept of one robot: tracks of its estimates, fixes, fusion records and learned numbers. All bounded.

import { markOf } from './marks.js';
import { Quantity } from './quantity.js';
import { Track } from './track.js';
import { Words } from './words.js';

export const ESTIMATE_COLUMNS = [
  'robot_s', 'x_m', 'y_m', 'heading_rad', 'major_m', 'minor_m', 'axis_rad', 'heading_sigma_rad',
  'forward_m_per_s', 'turn_rad_per_s', 'reset_counter', 'is_dead_reckoning', 'fix_age_s',
  'is_relative', 'is_heading_known',
];
const TALLY_COLUMNS = ['seen', 'gated', 'late', 'nis', 'consistency'];
const FUSION_COLUMNS = ['nis', 'dof', 'mark', 'verdict', 'is_slip', 'innovation0', 'innovation1', 'innovation2', 'sigma0', 'sigma1', 'sigma2'];
const FUSION_PEAKS = ['nis', 'innovation0', 'innovation1', 'innovation2'];

// 80 s at the 50 Hz at which a station sends; the map shows 60 s.
export const LIVE_CAPACITY = 4096;
// A robot has a handful of each; more than this is not a robot but nonsense.
const MOST_SENSORS = 32;
const MOST_CALIBRATED = 64;
const MOST_KINDS = 8;
const MOST_FILTERS = 16;
// Thermometers of a brick, and the robot's own quantity.
const MOST_QUANTITIES = 17;
const MOST_SWITCHES = 256;
const MOST_NAME = 60;
// Learned numbers change slowly: 1024 samples at this distance are five minutes. Of a recording there are an eighth as many as estimates.
const CALIBRATION_EVERY_S = 0.3;
const CALIBRATION_CAPACITY = 1024;

export class Robot {
  constructor(id, capacity = LIVE_CAPACITY) {
    this.id = id;
    this.name = '';
    /** When the station lost it last. */
    this.lost_s = NaN;
    /** The numbers of its sources that are left out; null where the station says nothing of it. */
    this.switchedOff = null;
    // Counts what was told of switches: who shows them looks whether there is anything new.
    this.switchesTold = 0;
    this.capacity = capacity;
    this.estimates = new Track(ESTIMATE_COLUMNS, capacity);
    // Of a recording as many come as of estimates, live there are fewer.
    this.recordCapacity = capacity > LIVE_CAPACITY ? capacity : capacity / 2;
    this.fixes = new Track(['x_m', 'y_m', 'heading_rad', 'mark'], this.recordCapacity);
    /** Dead reckoning by its wheels, of one that is not simulated. */
    this.odometry = new Track(['x_m', 'y_m', 'heading_rad', 'is_relative'], this.recordCapacity);
    /** filter -> track of its positions, of those that run beside the one that sends, in the order in which they were heard. */
    this.compared = new Map();
    /** How all filters do, the one that sends first; see ComparisonRow of the station. */
    this.comparison = NOTHING;
    /** name -> Quantity: that of its own filter under '', and thermometers. */
    this.quantities = new Map();
    /** sensor -> Source */
    this.sources = new Map();
    /** name -> { name, unit, value, sigma, isLearned, track } */
    this.calibration = new Map();
  }

  /** What people call it. */
  get label() {
    return this.name || this.id;
  }

  /** The one quantity that its filter knows; null for a filter of a pose. */
  get quantity() {
    return this.quantities.get('') ?? null;
  }

  /** What its filter publishes, a pose or a quantity, as a track. */
  get published() {
    return this.estimates.length > 0 ? this.estimates : this.quantity?.track ?? this.estimates;
  }

  /** Takes what a frame or a history says of this robot; anything that is not as agreed is left out. */
  apply(part, now_s) {
    if (typeof part.name === 'string') this.name = part.name.slice(0, MOST_NAME);
    if (Number.isFinite(part.lost_t_s)) this.lost_s = part.lost_t_s;
    if (Array.isArray(part.switched_off)) {
      this.switchedOff = new Set(part.switched_off.slice(0, MOST_SWITCHES));
      this.switchesTold += 1;
    }
    for (const estimate of list(part.estimates)) this.estimates.append(estimate);
    for (const point of list(part.odometry)) this.odometry.append(point);
    for (const fix of list(part.fixes)) this.#fix(fix);
    for (const record of list(part.fusion)) this.#record(record);
    for (const point of list(part.compared)) this.#compared(point.filter)?.append(point);
    for (const point of list(part.quantities)) this.#quantity(point)?.take(point);
    if (list(part.comparison).length > 0) {
      this.comparison = part.comparison.slice(0, MOST_FILTERS);
      for (const { filter } of this.comparison) if (filter) this.#compared(filter);
    }
    for (const tally of list(part.tallies)) this.#source(tally)?.count(tally);
    for (const entry of list(part.calibration)) this.#learned(entry, now_s);
  }

  #fix(fix) {
    const mark = markOf(fix.verdict, fix.lag_s);
    this.fixes.append({ t_s: fix.t_s, x_m: fix.x_m, y_m: fix.y_m, heading_rad: fix.heading_rad, mark });
  }

  #compared(name) {
    const filter = String(name).slice(0, 40);
    let track = this.compared.get(filter);
    if (!track) {
      if (this.compared.size >= MOST_FILTERS) return null;
      track = new Track(['x_m', 'y_m', 'is_relative'], this.recordCapacity);
      this.compared.set(filter, track);
    }
    return track;
  }

  #quantity(point) {
    const name = String(point.name ?? '').slice(0, 40);
    let quantity = this.quantities.get(name);
    if (!quantity) {
      if (this.quantities.size >= MOST_QUANTITIES) return null;
      const kind = String(point.kind ?? '').slice(0, 40);
      quantity = new Quantity({ name, kind, unit: String(point.unit ?? '').slice(0, 20) }, name ? this.recordCapacity : this.capacity);
      this.quantities.set(name, quantity);
    }
    return quantity;
  }

  #record(record) {
    this.#source(record)?.take(record);
  }

  #source(said) {
    const sensor = String(said.sensor).slice(0, 40);
    let source = this.sources.get(sensor);
    if (!source && this.sources.size < MOST_SENSORS) {
      source = new Source(sensor, String(said.kind).slice(0, 40), this.recordCapacity);
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
        track: new Track(['value', 'sigma'], Math.max(CALIBRATION_CAPACITY, this.capacity / 8), ['value', 'sigma']) };
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

/** What is kept of one sensor: records of the last while, and the station's counts of all that came. */
class Source {
  constructor(sensor, kind, capacity) {
    this.sensor = sensor;
    this.kind = kind;
    this.capacity = capacity;
    this.track = new Track(FUSION_COLUMNS, capacity, FUSION_PEAKS);
    this.verdicts = new Words();
    this.findings = new Words();
    /** kind -> counts over time: a sensor may be heard in more than one way. */
    this.counts = new Map();
  }

  take(record) {
    const innovation = list(record.innovation);
    const sigma = list(record.sigma);
    this.track.append({
      t_s: record.t_s,
      nis: record.dof > 0 ? record.nis : NaN,
      dof: record.dof,
      mark: markOf(record.verdict, record.lag_s),
      verdict: this.verdicts.number(record.verdict),
      is_slip: record.verdict === 'slip',
      innovation0: innovation[0], innovation1: innovation[1], innovation2: innovation[2],
      sigma0: sigma[0], sigma1: sigma[1], sigma2: sigma[2],
    });
  }

  /** Takes how many the station has counted until an instant. What is thinned on its way here is counted there. */
  count(tally) {
    const kind = String(tally.kind).slice(0, 40);
    if (!this.counts.has(kind)) {
      if (this.counts.size >= MOST_KINDS) return;
      this.counts.set(kind, new Track(TALLY_COLUMNS, Math.max(64, this.capacity / 8)));
    }
    this.counts.get(kind).append({ ...tally, consistency: this.findings.number(tally.consistency) });
  }

  /** How many came until a time, `seen`, `gated` or `late`; NaN where the station has said nothing. */
  counted(name, until_s) {
    let sum = NaN;
    for (const track of this.counts.values()) {
      const row = track.rowUntil(until_s);
      if (row >= 0) sum = (Number.isNaN(sum) ? 0 : sum) + track.columns[name][row];
    }
    return sum;
  }

  /** Mean NIS and verdict of the latest until a time; null where nothing was predicted. */
  judged(until_s) {
    for (const track of this.counts.values()) {
      const row = track.rowUntil(until_s);
      if (row >= 0 && !Number.isNaN(track.columns.nis[row])) {
        return { nis: track.columns.nis[row], consistency: this.findings.text(track.columns.consistency[row]) };
      }
    }
    return null;
  }

  /** What became of the last one until a time; empty before the first. */
  verdict(until_s) {
    const row = this.track.rowUntil(until_s);
    return row < 0 ? '' : this.verdicts.text(this.track.columns.verdict[row]);
  }
}

/** The value if it is an array, else an empty one: what comes from a wire may be anything. */
export function list(value) {
  return Array.isArray(value) ? value : NOTHING;
}

const NOTHING = Object.freeze([]);
