// All that the page knows of a session, live or replayed: robots, truth, errors, links, log. Pure: messages in, state out, no DOM.

import { Errors } from './errors.js';
import { LIVE_CAPACITY, Robot, list } from './robot.js';
import { Track } from './track.js';

const MOST_ROBOTS = 64;
const MOST_LOG_LINES = 300;
const MOST_TEXT = 400;

export class Session {
  constructor(capacity = LIVE_CAPACITY) {
    this.capacity = capacity;
    this.now_s = 0;
    this.robots = new Map();
    this.truth = new Track(['x_m', 'y_m', 'heading_rad', 'odometry_x_m', 'odometry_y_m', 'odometry_heading_rad'], capacity);
    this.errors = new Map();
    this.links = [];
    this.clock = null;
    this.log = [];
    this.logged = 0;
    this.dropped = 0;
    this.revision = 0;
  }

  /** Takes a frame or a history. */
  apply(frame) {
    if (!isRecord(frame)) return;
    if (Number.isFinite(frame.now_s)) this.now_s = Math.max(this.now_s, frame.now_s);
    for (const sample of list(frame.truth)) this.#truth(sample);
    for (const part of list(frame.robots)) this.#robot(part);
    if (Array.isArray(frame.links)) this.links = frame.links.filter(isRecord).slice(0, 64);
    if (isRecord(frame.clock)) this.clock = frame.clock;
    for (const line of list(frame.log)) this.#line(line);
    if (Number.isFinite(frame.dropped)) this.dropped = frame.dropped;
    this.revision += 1;
  }

  /** First and last instant of any estimate or truth; null without any. */
  span() {
    let from_s = Infinity;
    let to_s = -Infinity;
    for (const track of [this.truth, ...[...this.robots.values()].map((robot) => robot.estimates)]) {
      if (track.length === 0) continue;
      from_s = Math.min(from_s, track.columns.t_s[track.begin]);
      to_s = Math.max(to_s, track.columns.t_s[track.end - 1]);
    }
    return from_s <= to_s ? { from_s, to_s } : null;
  }

  #truth(sample) {
    if (!isRecord(sample)) return;
    const odometry = list(sample.odometry);
    this.truth.append({
      t_s: sample.t_s, x_m: sample.x_m, y_m: sample.y_m, heading_rad: sample.heading_rad,
      odometry_x_m: odometry[0], odometry_y_m: odometry[1], odometry_heading_rad: odometry[2],
    });
  }

  #robot(part) {
    if (!isRecord(part)) return;
    const id = String(part.id).slice(0, 60);
    let robot = this.robots.get(id);
    if (!robot) {
      if (this.robots.size >= MOST_ROBOTS) return;
      robot = new Robot(id, this.capacity);
      this.robots.set(id, robot);
      this.errors.set(id, new Errors(this.capacity));
    }
    robot.apply(part, this.now_s);
    // Truth is that of the simulated brick, of which a station has one: with it there is one robot.
    if (this.truth.length > 0) this.errors.get(id).update(this.truth, robot.estimates);
  }

  #line(line) {
    if (!isRecord(line)) return;
    this.logged += 1;
    this.log.push({ t_s: line.t_s, severity: String(line.severity ?? 'info').slice(0, 20), text: String(line.text).slice(0, MOST_TEXT) });
    if (this.log.length > MOST_LOG_LINES) this.log.shift();
  }
}

export function isRecord(value) {
  return typeof value === 'object' && value !== null && !Array.isArray(value);
}
