// The page's own arithmetic, without a browser: tracks, bands, errors against the truth, sliders, marks, numbers for people.

import assert from 'node:assert/strict';
import { createHash } from 'node:crypto';
import { readFile } from 'node:fs/promises';
import { test } from 'node:test';
import { NIS_BAND_95, nisBand } from './web/model/chi_square.js';
import { Fleet } from './web/fleet.js';
import { Errors } from './web/model/errors.js';
import { LATE_FROM_S, MARKS, markOf } from './web/model/marks.js';
import { robotRows } from './web/model/robot_list.js';
import { Session } from './web/model/session.js';
import { silence_s } from './web/model/silence.js';
import { rounded, scaleOf } from './web/model/slider.js';
import { comparableRow, readTruth } from './web/model/same_instant.js';
import { Track } from './web/model/track.js';
import { Station } from './web/station.js';
import { Stream } from './web/stream.js';
import * as format from './web/view/format.js';
import { headline } from './web/view/headline.js';

function part(track, name) {
  return track.columns[name].subarray(track.begin, track.end);
}

test('a track keeps the newest samples, sorted, in one piece', () => {
  const track = new Track(['x_m'], 10);
  for (let step = 0; step < 35; step += 1) track.append({ t_s: step, x_m: 2 * step });
  assert.equal(track.length, 10);
  assert.deepEqual([...part(track, 't_s')], [25, 26, 27, 28, 29, 30, 31, 32, 33, 34]);
  assert.deepEqual([...part(track, 'x_m')].at(-1), 68);
  track.append({ t_s: 31.5, x_m: 1 });
  assert.deepEqual([...part(track, 't_s')], [26, 27, 28, 29, 30, 31, 31.5, 32, 33, 34]);
  assert.equal(track.columns.x_m[track.rowUntil(31.7)], 1);
});

test('a quantity has its last reading, its verdict and its silence at any time', () => {
  const session = new Session();
  const point = (t_s, reading, verdict, estimate, more = {}) => ({ t_s, name: '', kind: 'wall_range', unit: 'm', reading, verdict, estimate, bound_95: 0.1, rate_per_s: -0.2, steps: 10 * t_s, predicted: t_s, ...more });
  const points = [point(1, 2, 'accepted', 2), point(1.1, 0.5, 'gated', null), point(1.2, null, '', 1.9), point(1.3, 'far', {}, 'near')];
  session.apply({ now_s: 1.2, robots: [{ id: '0/1/1', quantities: [...points.slice(0, 3), point(1.2, 20, 'accepted', null, { name: 'temp1', kind: 'temperature', unit: '°C' })] }] });
  const robot = session.robots.get('0/1/1');
  const { verdict, isRefused, reading, estimate, steps, predicted } = robot.quantity.at(1.2);
  assert.deepEqual([verdict, isRefused, reading, estimate, steps, predicted], ['gated', true, 0.5, 1.9, 12, 1.2]);
  assert.equal(robot.quantity.at(1.05).verdict, 'accepted');
  assert.equal(robot.quantity.at(0.5), null);
  assert.equal(Math.floor(robot.quantity.at(6.5).silent_s), 5);
  assert.deepEqual(session.thermometers().map((one) => one.quantity.name), ['temp1']);
  assert.ok(Number.isNaN(session.thermometers()[0].quantity.at(2).estimate));
  // It is a robot without a pose: no map, but it is heard, and falls silent.
  assert.equal(session.hasOnlyQuantities(), true);
  assert.deepEqual(robotRows(session, 1.3).map(({ state }) => state), ['live']);
  assert.deepEqual(robotRows(session, 9).map(({ state }) => state), ['silent']);
  session.apply({ now_s: 2, robots: [{ id: '0/1/1', quantities: [points[3], ...Array.from({ length: 99 }, (_, index) => point(1, 20, 'accepted', 1, { name: `temp${index}` }))] }] });
  assert.equal(robot.quantities.size, 17);
  session.apply({ now_s: 3, robots: [{ id: '0/2/1', estimates: [{ t_s: 3, x_m: 0, y_m: 0 }] }] });
  assert.equal(session.hasOnlyQuantities(), false);
});

test('a track grows to its capacity and no further', () => {
  const track = new Track(['x_m'], 1000);
  const sizes = new Set();
  for (let step = 0; step < 10_000; step += 1) {
    track.append({ t_s: step, x_m: 2 * step });
    sizes.add(track.columns.x_m.length);
  }
  assert.deepEqual([...sizes], [256, 512, 1024, 2000]);
  const kept = [...part(track, 'x_m')];
  assert.deepEqual([kept.length, kept[0], kept.at(-1)], [1000, 18_000, 19_998]);
});

test('a track finds rows by time', () => {
  const track = new Track([], 8);
  for (const t_s of [1, 2, 2, 3]) track.append({ t_s });
  assert.equal(track.rowAt(2) - track.begin, 1);
  assert.equal(track.rowAfter(2) - track.begin, 3);
  assert.equal(track.rowUntil(0.5), -1);
  assert.equal(track.rowUntil(99) - track.begin, 3);
});

test('a track with peaks keeps the whole run in the same room: what is new in full, of what is old every peak', () => {
  const track = new Track(['a', 'b'], 100, ['a', 'b']);
  const spikes = new Map([[137, { a: 50 }], [1234, { a: -60 }], [2000, { b: 70 }]]);
  for (let step = 0; step < 5000; step += 1) track.append({ t_s: step / 10, a: Math.sin(step), b: 0, ...spikes.get(step) });
  assert.equal(track.rows, 200);
  const times = [...part(track, 't_s')];
  assert.equal(times[0], 0);
  assert.deepEqual(times.slice(-100), Array.from({ length: 100 }, (_, index) => (4900 + index) / 10));
  for (const [step, spike] of spikes) {
    const row = times.indexOf(step / 10);
    for (const [name, value] of Object.entries(spike)) assert.equal(part(track, name)[row], value, `${name} at ${step}`);
  }
  assert.ok(times.every((t_s, row) => row === 0 || t_s > times[row - 1]));
  assert.ok(Math.abs(track.spacing_s() - 0.1) < 1e-9, 'that of what is kept in full');
  // A chart of the whole run has fewer points and the same peaks; the choice is the same when the window moves on a little.
  const shown = track.shown(0, 500, 60);
  assert.ok(shown.length <= 70, `${shown.length}`);
  for (const step of spikes.keys()) assert.ok(shown.includes(track.begin + times.indexOf(step / 10)), `${step}`);
  assert.equal(track.shown(490, 500, 200).length, 100);
});

test('what is no number becomes a gap, and a sample without a time is refused', () => {
  const track = new Track(['x_m'], 4);
  assert.equal(track.append({ t_s: null, x_m: 1 }), false);
  assert.equal(track.append({ t_s: NaN, x_m: 1 }), false);
  assert.equal(track.append({ t_s: 'soon', x_m: 1 }), false);
  for (const x_m of [null, 'far', Infinity, {}]) assert.equal(track.append({ t_s: 1, x_m }), true);
  assert.equal(track.length, 4);
  assert.ok([...part(track, 'x_m')].every(Number.isNaN));
});

// Simpson's rule over the density of chi-square; x = u^2 takes the pole at zero of one degree of freedom away.
function chiSquareBelow(limit, degreesOfFreedom) {
  const gamma = { 1: Math.sqrt(Math.PI), 2: 1, 3: Math.sqrt(Math.PI) / 2 }[degreesOfFreedom];
  const density = (u) => (2 * u ** (degreesOfFreedom - 1) * Math.exp((-u * u) / 2)) / (2 ** (degreesOfFreedom / 2) * gamma);
  const steps = 2000;
  const width = Math.sqrt(limit) / steps;
  let sum = density(0) + density(steps * width);
  for (let step = 1; step < steps; step += 1) sum += (step % 2 === 1 ? 4 : 2) * density(step * width);
  return (sum * width) / 3;
}

test('the bands of NIS hold 95 in 100, half of the rest on each side', () => {
  for (const [degreesOfFreedom, [low, high]] of Object.entries(NIS_BAND_95)) {
    assert.ok(Math.abs(chiSquareBelow(low, Number(degreesOfFreedom)) - 0.025) < 1e-5, `low, ${degreesOfFreedom}`);
    assert.ok(Math.abs(chiSquareBelow(high, Number(degreesOfFreedom)) - 0.975) < 1e-5, `high, ${degreesOfFreedom}`);
  }
  assert.equal(nisBand(0), null);
  assert.equal(nisBand(NaN), null);
});

test('errors are those that the station tells, and nothing is worked out from what came at the same time', () => {
  const session = new Session();
  // A robot whose estimates come 0.1 s late: held against the truth of their arrival they would seem 0.1 m off.
  const frame = (t_s, scores) => ({ now_s: t_s, truth: [{ t_s, x_m: t_s, y_m: 0, odometry: [t_s, 0, 0] }], robots: [{ id: 'a', estimates: [{ t_s, x_m: t_s - 0.1, y_m: 0 }], ...scores }] });
  for (const t_s of [1, 1.1, 1.2]) session.apply(frame(t_s, {}));
  const errors = session.errors.get('a');
  assert.equal(errors.track.length, 0);
  assert.ok(Number.isNaN(errors.recent('estimate_m', 1.2)));
  const score = (t_s, estimate_m) => ({ t_s, estimate_m, odometry_m: 0.3, claim_m: 0.01 });
  session.apply(frame(1.3, { scores: [score(1.2, 0.003), score(1.3, 0.004)] }));
  session.apply(frame(1.4, {}));
  assert.equal(errors.track.length, 2);
  assert.ok(Math.abs(errors.recent('estimate_m', 1.4) - Math.sqrt((0.003 ** 2 + 0.004 ** 2) / 2)) < 1e-12);
  assert.ok(Number.isNaN(errors.recent('estimate_m', 50)));
});

test('a robot that nobody hears is not said to be good', () => {
  const session = new Session();
  const estimates = Array.from({ length: 50 }, (_, index) => ({ t_s: 0.02 * index, x_m: 0, y_m: 0, major_m: 0.01 }));
  const scores = estimates.map(({ t_s }) => ({ t_s, estimate_m: 0.002, odometry_m: 0.5, claim_m: 0.01 }));
  session.apply({ now_s: 1, robots: [{ id: 'a', estimates, scores }] });
  const [robot] = session.estimated();
  const errors = session.errors.get('a');
  assert.equal(silence_s(robot.estimates, 1.5), 0);
  assert.equal(headline({ errors, robot, until_s: 1 }), 'odometry 0.50 m off, estimate 0.002 m off');
  // The cable is out: the brick's odometry is known from the simulator, the estimate is not.
  for (const t_s of [2, 2.5, 3]) session.apply({ now_s: t_s, robots: [{ id: 'a', scores: [{ t_s, estimate_m: null, odometry_m: 0.7, claim_m: null }] }] });
  assert.ok(Math.abs(silence_s(robot.estimates, 3) - 2.02) < 1e-9);
  assert.equal(headline({ errors, robot, until_s: 3 }), 'odometry 0.70 m off, estimate not known');
});

test('of several robots the headline says which', () => {
  const session = new Session();
  session.apply({ now_s: 1, robots: [{ id: 'a', name: 'left', estimates: [{ t_s: 1, x_m: 0, y_m: 0 }], scores: [{ t_s: 1, estimate_m: 0.002, odometry_m: 0.5 }] }] });
  const [robot] = session.estimated();
  const errors = session.errors.get('a');
  assert.equal(headline({ errors, robot, until_s: 1, isOneOfMany: true }), 'left: odometry 0.50 m off, estimate 0.002 m off');
  assert.equal(headline({ errors: null, robot, until_s: 1, isOneOfMany: true }), 'robot left');
});

test('the list of robots says how each was at the time that is shown', () => {
  const session = new Session();
  const estimate = (t_s) => ({ t_s, x_m: 0, y_m: 0, major_m: 0.004, reset_counter: 2, fix_age_s: 0.5 });
  const until = (end_s) => Array.from({ length: 50 * end_s + 1 }, (_, index) => estimate(index / 50));
  session.apply({ now_s: 10, robots: [{ id: 'a', name: 'left', estimates: until(10) }, { id: 'b', estimates: until(4), lost_t_s: 8 }, { id: 'c' }] });
  const states = (until_s) => robotRows(session, until_s).map(({ state }) => state);
  assert.deepEqual(states(3), ['live', 'live']);
  assert.deepEqual(states(7), ['live', 'silent']);
  assert.deepEqual(states(9), ['live', 'lost']);
  assert.deepEqual(states(-1), ['waiting', 'waiting']);
  const [left, second] = robotRows(session, 7);
  assert.deepEqual([left.name, left.sigma_m, left.resets, left.fixAge_s], ['left', 0.004, 2, 0.5]);
  assert.deepEqual([second.name, second.silent_s, second.fixAge_s], ['', 3, 3.5]);
  // It is back: what the station said of its loss is over.
  session.apply({ now_s: 12, robots: [{ id: 'b', estimates: [estimate(12)] }] });
  assert.deepEqual(states(12), ['silent', 'live']);
});

test('a truth is of the robot that it names, else of the first', () => {
  const session = new Session();
  const at = (x_m, robot) => ({ t_s: 1, x_m, y_m: 0, ...robot });
  session.apply({ now_s: 1, truth: [at(1)] });
  assert.equal(session.truthOf(null).columns.x_m[0], 1);
  session.apply({ robots: ['a', 'b', 'c'].map((id) => ({ id, estimates: [{ t_s: 1, x_m: 0, y_m: 0 }] })), truth: [at(2, { robot: 'b' })] });
  const [first, second, third] = session.estimated().map((robot) => session.truthOf(robot));
  assert.deepEqual([first.columns.x_m[0], second.columns.x_m[0], third], [1, 2, null]);
});

test('of a long recording every few seconds an estimate is no silence', () => {
  const estimates = new Track([], 100);
  for (let t_s = 0; t_s < 200; t_s += 2) estimates.append({ t_s });
  assert.equal(silence_s(estimates, 105.9), 0);
  assert.ok(silence_s(estimates, 210) > 10);
  assert.equal(silence_s(new Track([], 4), 5), 0);
  const errors = new Errors(100);
  for (let t_s = 0; t_s < 200; t_s += 2) errors.take({ t_s, estimate_m: 0.002 });
  assert.ok(Math.abs(errors.recent('estimate_m', 105.9) - 0.002) < 1e-12);
});

test('a source counts what the station has counted, until the time that is shown', () => {
  const session = new Session(20_000, 20_000);
  const record = (t_s, verdict) => ({ t_s, sensor: 'wheels', kind: 'wheel_angles', verdict, lag_s: 0, nis: null, dof: 0, innovation: [], sigma: [] });
  const tally = (t_s, seen, gated) => ({ t_s, sensor: 'wheels', kind: 'wheel_angles', seen, gated, late: 1 });
  session.apply({ now_s: 60, robots: [{ id: 'a', fusion: [record(1, 'accepted'), record(40, 'gated')], tallies: [tally(10, 200, 0), tally(60, 1200, 7)] }] });
  const source = session.robots.get('a').sources.get('wheels');
  assert.deepEqual(['seen', 'gated', 'late'].map((name) => source.counted(name, 60)), [1200, 7, 1]);
  assert.deepEqual(['seen', 'gated', 'late'].map((name) => source.counted(name, 59)), [200, 0, 1]);
  assert.ok(Number.isNaN(source.counted('seen', 5)));
  assert.deepEqual([0.5, 39, 40].map((until_s) => source.verdict(until_s)), ['', 'accepted', 'gated']);
  // Observations of another kind from the same sensor are counted as well.
  session.apply({ now_s: 61, robots: [{ id: 'a', tallies: [{ ...tally(61, 5, 1), kind: 'wheel_rates' }] }] });
  assert.equal(source.counted('seen', 61), 1205);
});

test('the log of a recording ends at the time that is shown', () => {
  const session = new Session(20_000, 20_000);
  session.apply({ now_s: 900, log: Array.from({ length: 900 }, (_, t_s) => ({ t_s, severity: 6, text: `${t_s}` })) });
  assert.equal(session.log.length, 900);
  assert.equal(session.loggedUntil(-1), 0);
  assert.equal(session.loggedUntil(293.5), 294);
  assert.equal(session.loggedUntil(1e9), 900);
});

test('what was learned stands at its own time', () => {
  const session = new Session(20_000, 20_000);
  const row = (t_s, value) => ({ t_s, name: 'radius_scale', value, sigma: 0.01, unit: '' });
  session.apply({ now_s: 30, robots: [{ id: 'a', calibration: [row(10, 0.1), row(20, 0.2), row(30, 0.3)] }] });
  const { track } = session.robots.get('a').calibration.get('radius_scale');
  assert.equal(track.columns.value[track.rowUntil(25)], 0.2);
  assert.equal(track.rowUntil(5), -1);
});

test('a session takes nonsense without a word and stays bounded', () => {
  const session = new Session();
  const nonsense = [null, 3, 'x', [], { robots: 'all' }, { robots: [null, 3, { id: {}, estimates: 'none', fixes: [{}], fusion: [{ innovation: 3 }] }] }, { truth: [null, { t_s: 1 }] }, { log: [null, { text: null }] }, { links: [null] }];
  for (const message of nonsense) session.apply(message);
  for (let number = 0; number < 500; number += 1) {
    session.apply({ truth: [{ t_s: 1, robot: `robot ${number}` }], robots: [{ id: `robot ${number}`, name: 'x'.repeat(1000), switched_off: 3, lost_t_s: 'now', fusion: [{ t_s: number, sensor: number, kind: 'fix' }] }], log: [{ t_s: number, severity: 'info', text: 'x'.repeat(10_000) }] });
  }
  assert.ok(session.robots.size <= 64 && session.truths.size <= 64);
  assert.ok([...session.robots.values()].every((robot) => robot.label.length <= 60));
  assert.ok(session.log.length <= 300);
  assert.ok(session.log.every((line) => line.text.length <= 400));
});

test('marks tell accepted, late, gated, too old and reset apart', () => {
  assert.equal(markOf('accepted', 0.01), MARKS.accepted);
  assert.equal(markOf('accepted', LATE_FROM_S), MARKS.late);
  assert.equal(markOf('gated', 9), MARKS.gated);
  assert.equal(markOf('too old', 9), MARKS.tooOld);
  assert.equal(markOf('reset to', 0), MARKS.resetTo);
  assert.equal(markOf('never heard of', 0), MARKS.other);
});

test('sliders reach both ends, and go there and back', () => {
  const parameters = [
    { least: 0.5, most: 0.999999, default: 0.999 }, { least: 0, most: 0.1, default: 0.00003 }, { least: 0.001, most: 1000, default: 0.8 }, { least: 4, most: 100, default: 10.83 },
  ];
  for (const parameter of parameters) {
    const scale = scaleOf(parameter);
    assert.ok(Math.abs(scale.toValue(0) - parameter.least) < 1e-12);
    assert.ok(Math.abs(scale.toValue(1) - parameter.most) < 1e-9 * parameter.most);
    for (const at of [0.1, 0.5, 0.9]) assert.ok(Math.abs(scale.toPosition(scale.toValue(at)) - at) < 1e-9);
    const position = scale.toPosition(parameter.default);
    assert.ok(position >= 0 && position <= 1);
  }
  assert.equal(rounded(12.34567, { least: 4, most: 100 }), 12.35);
  assert.equal(rounded(0.99999999, { least: 0.5, most: 0.999999 }), 0.999999);
});

test('the slider of a probability has room near one', () => {
  const gate = { least: 0.5, most: 0.999999, default: 0.999 };
  const scale = scaleOf(gate);
  const positions = [0.9, 0.99, 0.999, 0.9999].map((value) => scale.toPosition(value));
  for (let decade = 1; decade < positions.length; decade += 1) assert.ok(positions[decade] - positions[decade - 1] > 0.15, `${positions}`);
  assert.equal(rounded(0.99987654, gate), 0.99988);
  assert.equal(rounded(0.9123, gate), 0.912);
  assert.equal(format.compact(0.999999), '0.999999');
});

// What the page says to the person, and what it asks of the station.
function pageOf(answers, { isReplay = false } = {}) {
  const said = [];
  const asked = [];
  globalThis.fetch = async (path) => {
    asked.push(path);
    const { status = 200, body } = answers[path] ?? { status: 404, body: {} };
    return { ok: status < 400, status, statusText: '', text: async () => JSON.stringify(body) };
  };
  return { said, asked, announce: (text) => said.push(text), redraw: () => {}, replay: () => {}, isReplay: () => isReplay };
}

test('the list of recordings is read anew when another file is written', async () => {
  const rows = [{ name: 'recording.mcap', bytes: 5 }, { name: 'recording.2.mcap', bytes: 1, is_current: true }];
  const page = pageOf({ 'v1/recordings': { body: rows } });
  const station = new Station(page);
  station.greet({ recordings: [{ name: 'recording.mcap', bytes: 5, is_current: true }] });
  station.apply({ recording: { name: 'recording.mcap', bytes: 6 } });
  station.apply({});
  assert.deepEqual(page.asked, []);
  station.apply({ recording: { name: 'recording.2.mcap', bytes: 1 } });
  station.apply({ recording: { name: 'recording.2.mcap', bytes: 2 } });
  await new Promise(setImmediate);
  assert.deepEqual(page.asked, ['v1/recordings']);
  assert.equal(station.recordings.length, 2);
  station.apply({ recording: null });
  assert.equal(page.asked.length, 2);
});

test('while a recording is shown nothing is asked of the live robot', async () => {
  const page = pageOf({}, { isReplay: true });
  await new Station(page).command({ command: 'kidnap' });
  assert.deepEqual(page.asked, []);
  assert.match(page.said[0], /go back to live/);
});

test('a station that wants another token is told from one that is gone', async () => {
  const sockets = [];
  globalThis.WebSocket = class extends EventTarget {
    constructor() {
      super();
      sockets.push(this);
    }

    close() {}
  };
  const words = [];
  const stream = new Stream('ws://here/v1/stream', { onMessage: () => {}, onState: (state) => words.push(state) });
  const lose = async () => {
    stream.open();
    sockets.at(-1).dispatchEvent(new Event('close'));
    for (const timer of [stream.watch, stream.retry]) clearTimeout(timer);
    await new Promise(setImmediate);
  };
  globalThis.fetch = async () => { throw new TypeError('nobody answers'); };
  await lose();
  assert.deepEqual(words, ['connecting', 'lost']);
  globalThis.fetch = async () => ({ status: 401 });
  await lose();
  await lose();
  assert.deepEqual(words.slice(2), ['connecting', 'lost', 'refused']);
  stream.open();
  sockets.at(-1).dispatchEvent(Object.assign(new Event('message'), { data: '{"type":"hello"}' }));
  clearTimeout(stream.watch);
  assert.equal(words.at(-1), 'live');
});

test('numbers are written for people', () => {
  assert.equal(format.metres(0.4219), '0.42 m');
  assert.equal(format.metres(0.0061), '0.006 m');
  assert.equal(format.metres(NaN), '–');
  assert.equal(format.degrees(Math.PI / 2), '90.0°');
  assert.equal(format.withSigma(0.013131, 0.00093, 'rad/s'), '0.01313 ± 0.00093 rad/s');
  assert.equal(format.count(1234567), '1 234 567');
  assert.equal(format.bytes(1234567), '1.2 MB');
  assert.equal(format.clockTime(83.46), '1:23.5');
});

test('the vendored files are those that the note names', async () => {
  const note = await readFile(new URL('./web/vendor/README.md', import.meta.url), 'utf8');
  for (const file of ['uPlot.iife.min.js', 'uPlot.min.css']) {
    const sum = createHash('sha256').update(await readFile(new URL(`./web/vendor/${file}`, import.meta.url))).digest('hex');
    const row = note.split('\n').find((line) => line.startsWith(`| \`${file}\``));
    assert.ok(row?.includes(sum), `${file} has the checksum ${sum}`);
  }
});

test('truth and estimate are compared at one instant of the robot, however late each comes', () => {
  const truth = new Track(['robot_s', 'x_m', 'y_m', 'heading_rad'], 1000);
  const estimates = new Track(['robot_s', 'x_m'], 1000);
  // The robot drives 1 m/s and its clock is 5 s behind; truth comes after 10 ms every 50 ms, estimates after 70 ms every 30 ms.
  for (let k = 0; k < 100; k += 1) truth.append({ t_s: 0.01 + 0.05 * k, robot_s: 0.05 * k - 5, x_m: 0.05 * k, y_m: 0, heading_rad: 3.1 + 0.05 * k });
  for (let k = 0; k < 150; k += 1) estimates.append({ t_s: 0.07 + 0.03 * k, robot_s: 0.03 * k - 5, x_m: 0.03 * k });
  const names = ['x_m', 'y_m', 'heading_rad'];
  for (const until_s of [0.5, 1.234, 4]) {
    const row = comparableRow(estimates, truth, until_s);
    const pose = {};
    assert.ok(readTruth(pose, truth, until_s, estimates.columns.robot_s[row], names), `${until_s}`);
    assert.ok(Math.abs(pose.x_m - estimates.columns.x_m[row]) < 1e-9, `${until_s}: ${pose.x_m} ${estimates.columns.x_m[row]}`);
  }
  // Nothing is told of an instant that the truth has not reached, nor across a gap.
  assert.equal(readTruth({}, truth, 5, 0.5, names), false);
  truth.append({ t_s: 9, robot_s: 4, x_m: 9, y_m: 0, heading_rad: 0 });
  assert.equal(readTruth({}, truth, 9, 2, names), false);
});

test('a robot of the fleet becomes older when the station does not answer, and one of another station is told from those of this one', () => {
  const fleet = new Fleet(() => {});
  fleet.join('class');
  const row = (name, more) => ({ name, owner: { name: 'right', is_this: false }, estimate: { age_s: 0.25 }, ...more });
  fleet.take({ robots: [row('bob'), row('ada', { owner: { name: 'left', is_this: true } }), row('eve', { owner: null, estimate: null }), 'nonsense', {}], stations: [null, { name: 'left' }] }, 1000);
  assert.deepEqual(fleet.robots.map(({ name }) => name), ['bob', 'ada', 'eve']);
  assert.equal(fleet.stations.length, 1);
  const [bob, ada, eve] = fleet.robots;
  assert.deepEqual([fleet.age_s(bob, 1900), fleet.age_s(bob, 4500), fleet.age_s(eve, 1000)], [0.25, 3.75, NaN]);
  assert.deepEqual([fleet.isSilent(bob, 1900), fleet.isSilent(bob, 4500), fleet.isSilent(eve, 1000)], [false, true, true]);
  assert.deepEqual([bob, ada, eve].map((robot) => fleet.isElsewhere(robot)), [true, false, true]);
  fleet.take({ robots: Array.from({ length: 700 }, (_, index) => row(`r${index}`)) }, 2000);
  assert.deepEqual([fleet.robots.length, fleet.hidden], [500, 200]);
  fleet.join(null);
  assert.deepEqual([fleet.name, fleet.robots.length], [null, 0]);
});
