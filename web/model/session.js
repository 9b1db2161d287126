// All that the page knows of a session, live or replayed: robots, truth, errors, links, log. Pure: messages in, state out, no DOM.

import { Errors } from './errors.js';
import { LIVE_CAPACITY, Robot, list } from './robot.js';
import { Track } from './track.js';

const MOST_ROBOTS = 64;
// Live; of a recording as many as the station sends.
const MOST_LOG_LINES = 300;
const MOST_TEXT = 400;
const MOST_SETUP_ROWS = 16 * MOST_ROBOTS;
const TRUTH_COLUMNS = ['robot_s', 'x_m', 'y_m', 'heading_rad', 'odometry_x_m', 'odometry_y_m', 'odometry_heading_rad'];

export class Session {
  constructor(capacity = LIVE_CAPACITY, mostLogLines = MOST_LOG_LINES) {
    this.capacity = capacity;
    this.mostLogLines = mostLogLines;
    this.now_s = 0;
    /** The first instant of which anything was told; NaN before. */
    this.begin_s = NaN;
    this.robots = new Map();
    /** id of a robot -> where it really was; under '' that of the only simulated brick. */
    this.truths = new Map();
    this.errors = new Map();
    this.links = [];
    /** Steps of setting up each robot. */
    this.setup = [];
    this.clock = null;
    /** When links and clock were told last. */
    this.links_s = NaN;
    this.clock_s = NaN;
    this.log = [];
    this.logged = 0;
    this.dropped = 0;
    this.revision = 0;
  }

  /** Takes a frame, or a history: both have the same shape. */
  apply(frame) {
    if (!isRecord(frame)) return;
    if (Number.isFinite(frame.now_s)) this.now_s = Math.max(this.now_s, frame.now_s);
    for (const sample of list(frame.truth)) this.#truth(sample);
    for (const part of list(frame.robots)) this.#robot(part);
    if (Array.isArray(frame.links)) {
      this.links = frame.links.filter(isRecord).slice(0, 64);
      this.links_s = this.now_s;
    }
    if (Array.isArray(frame.setup)) this.setup = frame.setup.filter(isRecord).slice(0, MOST_SETUP_ROWS).map(setupRow);
    if (isRecord(frame.clock)) {
      this.clock = frame.clock;
      this.clock_s = this.now_s;
    }
    for (const line of list(frame.log)) this.#line(line);
    if (Number.isFinite(frame.dropped)) this.dropped = frame.dropped;
    if (Number.isNaN(this.begin_s)) this.begin_s = this.#firstTold();
    this.revision += 1;
  }

  /** Those with an estimate; a camera is heard as well but has none. Without any estimate all that are heard. */
  estimated() {
    const all = [...this.robots.values()];
    const estimated = all.filter((robot) => robot.published.length > 0);
    return estimated.length > 0 ? estimated : all;
  }

  /** Where a robot really was: a track, or null where nobody knows. What names no robot is of the first one. */
  truthOf(robot) {
    const own = robot ? this.truths.get(robot.id) : null;
    if (own) return own;
    const isFirst = !robot || robot === this.estimated()[0];
    return (isFirst ? this.truths.get('') : null) ?? null;
  }

  /** Whether all that filters here know is one quantity each: there is nothing to draw on a map. */
  hasOnlyQuantities() {
    const all = [...this.robots.values()];
    return all.some((robot) => robot.quantity) && all.every((robot) => robot.estimates.length === 0) && this.truths.size === 0;
  }

  /** The thermometers of all bricks, each with its brick. */
  thermometers() {
    const found = [];
    for (const robot of this.robots.values()) {
      for (const quantity of robot.quantities.values()) if (quantity.name) found.push({ robot, quantity });
    }
    return found;
  }

  /** First and last instant of any estimate, reading of a thermometer or truth; null without any. */
  span() {
    let from_s = Infinity;
    let to_s = -Infinity;
    const published = [...this.robots.values()].map((robot) => robot.published);
    const read = this.thermometers().map(({ quantity }) => quantity.track);
    for (const track of [...this.truths.values(), ...published, ...read]) {
      if (track.length === 0) continue;
      from_s = Math.min(from_s, track.columns.t_s[track.begin]);
      to_s = Math.max(to_s, track.columns.t_s[track.end - 1]);
    }
    return from_s <= to_s ? { from_s, to_s } : null;
  }

  /** How many of all lines that came so far had come by a time; `log` holds the last of all. */
  loggedUntil(until_s) {
    let low = 0;
    let high = this.log.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.log[middle].t_s <= until_s) low = middle + 1;
      else high = middle;
    }
    return this.logged - this.log.length + low;
  }

  // Of what charts show there may be more than of what the map shows.
  #firstTold() {
    const tracks = [...this.errors.values()].map(({ track }) => track);
    for (const robot of this.robots.values()) for (const known of [...robot.sources.values(), ...robot.calibration.values()]) tracks.push(known.track);
    const firsts = tracks.filter((track) => track.length > 0).map((track) => track.columns.t_s[track.begin]);
    const first_s = Math.min(this.span()?.from_s ?? Infinity, ...firsts);
    return Number.isFinite(first_s) ? first_s : NaN;
  }

  #truth(sample) {
    if (!isRecord(sample)) return;
    const odometry = list(sample.odometry);
    this.#truthTrack(sample.robot)?.append({
      t_s: sample.t_s, robot_s: sample.robot_s, x_m: sample.x_m, y_m: sample.y_m, heading_rad: sample.heading_rad,
      odometry_x_m: odometry[0], odometry_y_m: odometry[1], odometry_heading_rad: odometry[2],
    });
  }

  #truthTrack(robot) {
    const id = robot === undefined || robot === null ? '' : textOf(robot);
    let track = this.truths.get(id);
    if (!track && this.truths.size < MOST_ROBOTS) {
      track = new Track(TRUTH_COLUMNS, this.capacity);
      this.truths.set(id, track);
    }
    return track;
  }

  #robot(part) {
    if (!isRecord(part)) return;
    const id = textOf(part.id);
    let robot = this.robots.get(id);
    if (!robot) {
      if (this.robots.size >= MOST_ROBOTS) return;
      robot = new Robot(id, this.capacity);
      this.robots.set(id, robot);
      this.errors.set(id, new Errors(this.capacity));
    }
    robot.apply(part, this.now_s);
    const errors = this.errors.get(id);
    for (const score of list(part.scores).filter(isRecord)) errors.take(score);
  }

  #line(line) {
    if (!isRecord(line)) return;
    this.logged += 1;
    this.log.push({ t_s: line.t_s, severity: severityOf(line.severity), text: String(line.text).slice(0, MOST_TEXT) });
    if (this.log.length > this.mostLogLines) this.log.shift();
  }
}

// MAVLink's MAV_SEVERITY, 0 to 7.
const SEVERITIES = ['emergency', 'alert', 'critical', 'error', 'warning', 'notice', 'info', 'debug'];

function severityOf(value) {
  return SEVERITIES[value] ?? String(value ?? 'info').slice(0, 20);
}

function textOf(id) {
  return String(id).slice(0, 60);
}

export function isRecord(value) {
  return typeof value === 'object' && value !== null && !Array.isArray(value);
}

// Each step as text, whatever it is.
function setupRow(row) {
  const text = (value) => String(value ?? '').slice(0, 300);
  return { robot: text(row.robot), step: text(row.step), state: text(row.state), figure: text(row.figure), advice: text(row.advice) };
}
