// The fleet as the station knows it: asked for once a second, for the panel and the map.

import { list } from './model/robot.js';
import { isRecord } from './model/session.js';

const PERIOD_MS = 1000;
const MOST_ROBOTS = 500;
const MOST_STATIONS = 64;
// As of the robots of this station.
const SILENT_FROM_S = 1;
// Between two answers newer estimates come unseen; an answer that is older than this was not renewed.
const RENEWED_WITHIN_S = 3;

export class Fleet {
  #redraw;
  #asked_ms = -Infinity;
  #answered_ms = NaN;

  /** @param {() => void} redraw is called after each answer. */
  constructor(redraw) {
    this.#redraw = redraw;
    /** Null for a station that is in no fleet. */
    this.name = null;
    this.#forget();
  }

  /** Takes what a connection begins with. */
  join(name) {
    this.name = typeof name === 'string' ? name : null;
    this.#forget();
  }

  #forget() {
    this.stations = [];
    this.robots = [];
    /** So many robots are not shown. */
    this.hidden = 0;
    this.#asked_ms = -Infinity;
    this.#answered_ms = NaN;
  }

  /** Asks again, once a second; the last answer is waited for before. */
  poll(now_ms = performance.now()) {
    if (this.name === null || now_ms - this.#asked_ms < PERIOD_MS) return;
    this.#asked_ms = Infinity;
    // The connection's own line says when the station is away.
    this.#ask().catch(() => {}).finally(() => { this.#asked_ms = now_ms; });
  }

  async #ask() {
    const answer = await fetch('v1/fleet', { cache: 'no-store' });
    if (answer.ok) this.take(await answer.json(), performance.now());
    this.#redraw();
  }

  /** Takes an answer that came at a time. */
  take(state, now_ms) {
    this.#answered_ms = now_ms;
    this.stations = list(state.stations).filter(isRecord).slice(0, MOST_STATIONS);
    const robots = list(state.robots).filter((row) => isRecord(row) && typeof row.name === 'string');
    this.robots = robots.slice(0, MOST_ROBOTS);
    this.hidden = robots.length - this.robots.length;
  }

  /** The age of a robot's last estimate as of the last answer, and as of now when no more answers come; NaN without an estimate. */
  age_s({ estimate }, now_ms = performance.now()) {
    const since_s = (now_ms - this.#answered_ms) / 1000;
    return Number.isFinite(estimate?.age_s) ? estimate.age_s + (since_s < RENEWED_WITHIN_S ? 0 : since_s) : NaN;
  }

  isSilent(robot, now_ms) {
    return !(this.age_s(robot, now_ms) < SILENT_FROM_S);
  }

  /** Whether a robot is served by another station, or by none. */
  isElsewhere({ owner }) {
    return !owner?.is_this;
  }
}
