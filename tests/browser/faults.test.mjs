// The page of the real program with its simulated brick: what it shows is what the station knows, every fault button has its effect within
// two seconds of the session, and the session with all of them replays bit for bit.

import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { waitForState } from './support/page.mjs';
import { Program, newFolder, run } from './support/station.mjs';
import { Tap, estimatesOf, fixesOf, fusionOf } from './support/tap.mjs';

const EFFECT_WITHIN_S = 2;
const HARD_S = 12;

let station;
let browser;
let page;
let tap;

before(async () => {
  station = Program.start(['run', '--out', 'session', '--events', 'live.txt', '--dashboard', '127.0.0.1:0'], await newFolder());
  browser = await Browser.launch();
  tap = new Tap();
  // The last test ends the station: then, and only then, there is nobody to connect to.
  page = await browser.open(await station.address(), { tap, forgives: ['ERR_CONNECTION_REFUSED'] });
  await waitForState(page, 'live');
  await tap.until('a fix that was used', (frame) => fixesOf(frame).some((fix) => fix.verdict === 'accepted'));
});

after(async () => {
  await browser?.close();
  await station?.remove();
});

// Presses a button and waits for what it should bring; fails when that took more of the session's time than it may.
async function press(name, what, find, limit_s = EFFECT_WITHIN_S) {
  const begun_s = tap.now_s;
  await page.getByRole('button', { name, exact: true }).click();
  const effect = await tap.until(what, find, begun_s);
  assert.ok(effect.now_s - begun_s <= limit_s, `${what} after ${(effect.now_s - begun_s).toFixed(2)} s`);
  return { ...effect, begun_s };
}

// Waits until the robot is where it should be, and says so.
function recovered(from_s) {
  return tap.until('an estimate within 5 cm of the truth for a second', steadily((frame) => frame.errors && frame.errors.estimate_m < 0.05, 1), from_s);
}

// A finder for what holds without a break for some seconds.
function steadily(holds, seconds) {
  let since_s = null;
  return (frame) => {
    if (!estimatesOf(frame).length) return null;
    if (!holds(frame)) since_s = null;
    else since_s ??= frame.now_s;
    return since_s !== null && frame.now_s - since_s >= seconds;
  };
}

const logs = (pattern) => (frame) => frame.log?.find(({ text }) => pattern.test(text)) ?? null;

test('the pose on the page is that of /v1/state, one frame later at most', async () => {
  const found = await page.evaluate(comparePoses, 8);
  assert.ok(found.every(({ isEqual }) => isEqual), JSON.stringify(found, null, 1));
  // One message is on its way while the station answers; a second may come while the screen waits for its turn.
  assert.ok(found.every(({ messages }) => messages <= 2), JSON.stringify(found, null, 1));
});

// Runs in the page: asks for the state until a number of answers was met by the very same estimate on the page.
async function comparePoses(wanted) {
  const found = [];
  let messages = 0;
  const count = new WebSocket(`ws://${location.host}/v1/stream`);
  count.addEventListener('message', () => { messages += 1; });
  await new Promise((open) => { count.addEventListener('open', open); });
  const shown = document.getElementById('pose').dataset;
  for (let tries = 0; tries < 400 && found.length < wanted; tries += 1) {
    const { robots: [{ estimate }] } = await (await fetch('v1/state')).json();
    const before = messages;
    while (Number(shown.t_s) < estimate.t_s) await new Promise(requestAnimationFrame);
    if (Number(shown.t_s) !== estimate.t_s) continue;
    const isEqual = ['x_m', 'y_m', 'heading_rad', 'major_m', 'reset_counter'].every((name) => Number(shown[name]) === estimate[name]);
    found.push({ isEqual, messages: messages - before, t_s: estimate.t_s });
  }
  count.close();
  return found;
}

test('kidnap: fixes are gated, the estimate is reset, and is right again', async () => {
  const resets = tap.estimate.reset_counter;
  const { begun_s } = await press('Kidnap', 'a higher reset counter', (frame) => estimatesOf(frame).find((estimate) => estimate.reset_counter > resets));
  assert.ok(tap.frames.some((frame) => frame.now_s > begun_s && fixesOf(frame).some((fix) => fix.verdict === 'gated')));
  await page.waitForFunction((least) => Number(document.getElementById('pose').dataset.reset_counter) > least, resets);
  const { now_s } = await recovered(begun_s);
  assert.ok(now_s - begun_s < HARD_S, `right again after ${(now_s - begun_s).toFixed(1)} s`);
});

test('camera off: the ellipse grows; camera on: it shrinks', async () => {
  const before_m = tap.estimate.major_m;
  const grown = await press('Camera off', 'an ellipse that is half as large again', (frame) => estimatesOf(frame).find((estimate) => estimate.major_m > 1.5 * before_m));
  await page.waitForFunction((least_m) => Number(document.getElementById('pose').dataset.major_m) > least_m, 1.5 * before_m);
  await press('Camera on', 'a smaller ellipse', (frame) => estimatesOf(frame).find((estimate) => estimate.major_m < grown.found.major_m));
});

test('slip: the verdict is slip', async () => {
  await press('Slip', 'the verdict slip', (frame) => fusionOf(frame).find((record) => record.verdict === 'slip'));
  await page.locator('#innovations').scrollIntoViewIfNeeded();
  await page.waitForFunction(() => [...document.querySelectorAll('#log .text')].some((line) => /slip/i.test(line.textContent))
    || document.querySelector('#innovations tr[data-verdict="slip"]'));
  await recovered(tap.now_s);
});

test('camera late: fixes are applied late', async () => {
  await press('Camera late', 'a fix that is a quarter of a second late', (frame) => fixesOf(frame).find((fix) => fix.lag_s > 0.25));
  await page.getByLabel('by ms').fill('0');
  await press('Camera late', 'a fix in time', (frame) => fixesOf(frame).find((fix) => fix.lag_s < 0.15));
});

test('gyro bias step: the gyro disagrees with the wheels', async () => {
  const high = (record) => record.kind === 'wheel_angles' && record.dof > 0 && record.nis > 5.02;
  await press('Gyro bias step', 'a wheel window whose NIS is outside its band', (frame) => fusionOf(frame).find(high));
  await page.getByLabel('by °/s').fill('-3');
  await press('Gyro bias step', 'what became of it', logs(/gyro-bias-step/));
});

test('link: the link becomes as bad as the profile', async () => {
  await page.getByLabel('as bad as').selectOption('bluetooth-spp');
  await press('Link', 'what became of it', logs(/link-profile/));
  await page.getByLabel('as bad as').selectOption('');
  await press('Link', 'what became of it', logs(/link-profile/));
});

test('pull the cable: the link is down, and comes back', async () => {
  await page.getByLabel('for s').last().fill('1');
  const { begun_s } = await press('Pull the cable', 'a link that is down', logs(/link .* is down/));
  await tap.until('the link again', logs(/link .* is up/), begun_s);
  await recovered(begun_s);
});

test('steering by odometry and by estimate is asked of the brick', async () => {
  for (const by of ['odometry', 'estimate']) {
    const begun_s = tap.now_s;
    await page.getByLabel(by, { exact: true }).check();
    const { now_s } = await tap.until(`steering by ${by}`, logs(new RegExp(`steering.*${by}`)), begun_s);
    assert.ok(now_s - begun_s <= EFFECT_WITHIN_S);
  }
});

test('keys drive the robot, and it goes back to its path', async () => {
  await page.getByRole('button', { name: 'Drive with the keys' }).click();
  const begun_s = tap.now_s;
  await page.keyboard.down('a');
  const turning = await tap.until('a turn to the left', (frame) => estimatesOf(frame).find((estimate) => estimate.turn_rad_per_s > 0.5), begun_s);
  assert.ok(turning.now_s - begun_s <= EFFECT_WITHIN_S);
  await page.keyboard.up('a');
  await tap.until('a stop', (frame) => estimatesOf(frame).find((estimate) => Math.abs(estimate.turn_rad_per_s) < 0.1 && Math.abs(estimate.forward_m_per_s) < 0.02));
  await press('Back to the path', 'a robot that drives', (frame) => estimatesOf(frame).find((estimate) => Math.abs(estimate.forward_m_per_s) > 0.02 || Math.abs(estimate.turn_rad_per_s) > 0.1));
});

test('a slider changes a parameter of the filter', async () => {
  const slider = page.getByLabel('gate_prob, slider');
  await slider.scrollIntoViewIfNeeded();
  const begun_s = tap.now_s;
  await slider.focus();
  await slider.press('Home');
  const { found } = await tap.until('the parameter', (frame) => frame.parameters?.find(({ name, value }) => name === 'gate_prob' && value === 0.5), begun_s);
  assert.equal(found.value, 0.5);
  await slider.blur();
  await page.waitForFunction(() => document.getElementById('parameter-gate_prob').value === '0.5');
  await page.getByLabel('gate_prob back to').click();
  await tap.until('the default', (frame) => frame.parameters?.find(({ name, value }) => name === 'gate_prob' && value === 0.999));
});

test('the recording so far is looked at again, beside the drive that goes on', async () => {
  const [seen] = tap.frames.filter((frame) => estimatesOf(frame).length > 0);
  const [estimate] = estimatesOf(seen);
  await page.locator('#recordings').scrollIntoViewIfNeeded();
  await page.getByRole('button', { name: 'Replay recording.mcap' }).click();
  await page.getByRole('button', { name: 'Pause' }).click();
  await page.getByLabel('Time in the recording').fill(String(estimate.t_s + 0.001));
  await page.waitForFunction((t_s) => Math.abs(Number(document.getElementById('pose').dataset.t_s) - t_s) < 0.2, estimate.t_s);
  const shown = await page.evaluate(() => ({ ...document.getElementById('pose').dataset }));
  const live = tap.frames.flatMap(estimatesOf).find(({ t_s }) => t_s === Number(shown.t_s));
  assert.ok(live, `the instant ${shown.t_s} was live as well`);
  assert.equal(Number(shown.x_m), live.x_m);
  await page.getByRole('button', { name: 'Back to live' }).click();
  await page.waitForFunction((t_s) => Number(document.getElementById('pose').dataset.t_s) > t_s, estimate.t_s + 1);
});

test('the session with all that was done to it replays bit for bit', async () => {
  assert.equal(await station.stop(), 0, station.text);
  await waitForState(page, 'lost');
  await run(['replay', 'session/recording.mcap', '--events', 'replayed.txt'], station.folder);
  const [live, replayed] = await Promise.all(['live.txt', 'replayed.txt'].map((name) => readFile(path.join(station.folder, name), 'utf8')));
  assert.ok(live.includes('slip'), 'the recording holds what was done');
  const [liveLines, replayedLines] = [live.split('\n'), replayed.split('\n')];
  const different = liveLines.findIndex((line, index) => line !== replayedLines[index]);
  assert.equal(different, -1, `event ${different}:\n${liveLines[different]}\n${replayedLines[different]}`);
  assert.equal(liveLines.length, replayedLines.length);
});
