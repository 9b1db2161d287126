// The page's own arithmetic, without a browser: tracks, bands, errors against the truth, sliders, marks, numbers for people.

import assert from 'node:assert/strict';
import { createHash } from 'node:crypto';
import { readFile } from 'node:fs/promises';
import { test } from 'node:test';
import { NIS_BAND_95, nisBand } from './web/model/chi_square.js';
import { Errors } from './web/model/errors.js';
import { LATE_FROM_S, MARKS, markOf } from './web/model/marks.js';
import { Session } from './web/model/session.js';
import { rounded, scaleOf } from './web/model/slider.js';
import { Track } from './web/model/track.js';
import * as format from './web/view/format.js';

test('a track keeps the newest samples, sorted, in one piece', () => {
  const track = new Track(['x_m'], 10);
  for (let step = 0; step < 35; step += 1) track.append({ t_s: step, x_m: 2 * step });
  assert.equal(track.length, 10);
  assert.deepEqual([...track.part('t_s', track.begin, track.end)], [25, 26, 27, 28, 29, 30, 31, 32, 33, 34]);
  assert.deepEqual([...track.part('x_m', track.begin, track.end)].at(-1), 68);
  track.append({ t_s: 31.5, x_m: 1 });
  assert.deepEqual([...track.part('t_s', track.begin, track.end)], [26, 27, 28, 29, 30, 31, 31.5, 32, 33, 34]);
  assert.equal(track.columns.x_m[track.rowUntil(31.7)], 1);
});

test('a track finds rows by time', () => {
  const track = new Track([], 8);
  for (const t_s of [1, 2, 2, 3]) track.append({ t_s });
  assert.equal(track.rowAt(2) - track.begin, 1);
  assert.equal(track.rowAfter(2) - track.begin, 3);
  assert.equal(track.rowUntil(0.5), -1);
  assert.equal(track.rowUntil(99) - track.begin, 3);
});

test('what is no number becomes a gap, and a sample without a time is refused', () => {
  const track = new Track(['x_m'], 4);
  assert.equal(track.append({ t_s: null, x_m: 1 }), false);
  assert.equal(track.append({ t_s: NaN, x_m: 1 }), false);
  assert.equal(track.append({ t_s: 'soon', x_m: 1 }), false);
  for (const x_m of [null, 'far', Infinity, {}]) assert.equal(track.append({ t_s: 1, x_m }), true);
  assert.equal(track.length, 4);
  assert.ok([...track.part('x_m', track.begin, track.end)].every(Number.isNaN));
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

test('errors are those at the instant of the estimate, not of the last truth', () => {
  const session = new Session();
  // 1 m/s east; the estimate between two samples of truth is exact, odometry is 0.1 m off.
  session.begin({
    now_s: 2,
    truth: [0, 1, 2].map((t_s) => ({ t_s, x_m: t_s, y_m: 0, heading_rad: 0, odometry: [t_s, 0.1, 0] })),
    robots: [{ id: 'a', estimates: [{ t_s: 0.5, x_m: 0.5, y_m: 0, major_m: 0.01 }, { t_s: 1.25, x_m: 1.25, y_m: 0.03, major_m: 0.01 }] }],
  });
  const errors = session.errors.get('a');
  const rows = (name) => [...errors.track.part(name, errors.track.begin, errors.track.end)].map((value) => Number(value.toFixed(9)));
  assert.deepEqual(rows('estimate_m'), [0, 0.03]);
  assert.deepEqual(rows('odometry_m'), [0.1, 0.1]);
  assert.ok(Math.abs(errors.recent('estimate_m', 1.25) - 0.03 / Math.sqrt(2)) < 1e-9);
  assert.ok(Number.isNaN(errors.recent('estimate_m', 50)));
});

test('what the station tells of the errors goes before what is worked out here', () => {
  const session = new Session();
  const sample = (t_s) => ({ now_s: t_s, truth: [{ t_s, x_m: t_s, y_m: 0, odometry: [t_s, 0, 0] }], robots: [{ id: 'a', estimates: [{ t_s, x_m: t_s + 0.5, y_m: 0 }] }] });
  for (const t_s of [1, 1.1, 1.2]) session.apply({ ...sample(t_s), errors: { estimate_m: 0.002, odometry_m: 0.3 } });
  assert.ok(Math.abs(session.errors.get('a').recent('estimate_m', 1.2) - 0.002) < 1e-12);
  assert.ok(Math.abs(session.errors.get('a').recent('odometry_m', 1.2) - 0.3) < 1e-12);
});

test('an estimate waits for the truth after it', () => {
  const truth = new Track(['x_m', 'y_m', 'odometry_x_m', 'odometry_y_m'], 8);
  const estimates = new Track(['x_m', 'y_m', 'major_m'], 8);
  const errors = new Errors(8);
  truth.append({ t_s: 0, x_m: 0, y_m: 0, odometry_x_m: 0, odometry_y_m: 0 });
  estimates.append({ t_s: 0.5, x_m: 0.5, y_m: 0 });
  errors.update(truth, estimates);
  assert.equal(errors.track.length, 0);
  truth.append({ t_s: 1, x_m: 1, y_m: 0, odometry_x_m: 1, odometry_y_m: 0 });
  errors.update(truth, estimates);
  errors.update(truth, estimates);
  assert.equal(errors.track.length, 1);
  assert.equal(errors.track.columns.estimate_m[0], 0);
});

test('a session takes nonsense without a word and stays bounded', () => {
  const session = new Session();
  const nonsense = [null, 3, 'x', [], { robots: 'all' }, { robots: [null, 3, { id: {}, estimates: 'none', fixes: [{}], fusion: [{ innovation: 3 }] }] }, { truth: [null, { t_s: 1 }] }, { log: [null, { text: null }] }, { links: [null] }];
  for (const message of nonsense) session.apply(message);
  for (let number = 0; number < 500; number += 1) {
    session.apply({ robots: [{ id: `robot ${number}`, fusion: [{ t_s: number, sensor: number, kind: 'fix' }] }], log: [{ t_s: number, severity: 'info', text: 'x'.repeat(10_000) }] });
  }
  assert.ok(session.robots.size <= 64);
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
