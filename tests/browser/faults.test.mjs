// The page of the real program with its simulated brick: what it shows is what the station knows, every fault button has its effect within
// two seconds of the session, and the session with all of them replays bit for bit.

import assert from 'node:assert/strict';
import { readFile } from 'node:fs/promises';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { seeing, seen, waitForState } from './support/page.mjs';
import { Program, newFolder, run } from './support/station.mjs';
import { Tap, estimatesOf, fixesOf, fusionOf } from './support/tap.mjs';

const EFFECT_WITHIN_S = 2;
const HARD_S = 12;
// A bias is a doubt of the gyro that grows: some windows of wheels against gyro pass before one of them is beyond its band.
const WINDOWS_S = 5;

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

// Presses a button and waits for what it should bring; fails when that took more of the session's time than it may, from the instant at which
// the station took the command.
async function press(name, command, { what, find, limit_s = EFFECT_WITHIN_S }) {
  const before_s = tap.now_s;
  await page.getByRole('button', { name, exact: true }).click();
  const { found: { t_s: begun_s } } = await tap.until(`the command of ${name}`, logs(command), before_s);
  const effect = await tap.until(what, find, before_s);
  assert.ok(effect.now_s - begun_s <= limit_s, `${what} after ${(effect.now_s - begun_s).toFixed(2)} s`);
  return { ...effect, begun_s };
}

// Waits for the beginning of a straight leg: who stands or turns shows neither slip nor a growing ellipse.
async function drives() {
  await tap.until('a robot that stands or turns', (frame) => estimatesOf(frame).find((estimate) => estimate.forward_m_per_s < 0.05));
  await tap.until('a robot that drives', (frame) => estimatesOf(frame).find((estimate) => estimate.forward_m_per_s > 0.1));
}

// Waits until the robot is where it should be, and says so.
function recovered(from_s) {
  return tap.until('an estimate within 5 cm of the truth for a second', steadily((frame) => frame.errors.estimate_m < 0.05, 1), from_s);
}

// A finder for what holds of the errors without a break for some seconds; not every frame has them.
function steadily(holds, seconds) {
  let since_s = null;
  return (frame) => {
    if (!frame.errors) return null;
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
  await drives();
  const resets = tap.estimate.reset_counter;
  const { begun_s } = await press('Kidnap', /kidnap:/, {
    what: 'a higher reset counter',
    find: (frame) => estimatesOf(frame).find((estimate) => estimate.reset_counter > resets),
  });
  assert.ok(tap.frames.some((frame) => frame.now_s > begun_s && fixesOf(frame).some((fix) => fix.verdict === 'gated')));
  await page.waitForFunction((least) => Number(document.getElementById('pose').dataset.reset_counter) > least, resets);
  const { now_s } = await recovered(begun_s);
  assert.ok(now_s - begun_s < HARD_S, `right again after ${(now_s - begun_s).toFixed(1)} s`);
});

test('camera off: the ellipse grows; camera on: it shrinks', async () => {
  await drives();
  // It breathes with each fix: what counts is more than it ever was in the last second.
  const lately = tap.frames.filter((frame) => frame.now_s > tap.now_s - 1).flatMap(estimatesOf);
  const before_m = Math.max(...lately.map((estimate) => estimate.major_m));
  await press('Camera off', /camera: off/, {
    what: 'an ellipse that is larger by a fifth',
    find: (frame) => estimatesOf(frame).find((estimate) => estimate.major_m > 1.2 * before_m),
  });
  await page.waitForFunction((least_m) => Number(document.getElementById('pose').dataset.major_m) > least_m, 1.2 * before_m);
  const dark_m = tap.estimate.major_m;
  await press('Camera on', /camera: on/, {
    what: 'a smaller ellipse',
    find: (frame) => estimatesOf(frame).find((estimate) => estimate.major_m < dark_m),
    // How soon it is as small as before is the filter's affair: it learns anew how noisy the camera is.
    limit_s: WINDOWS_S,
  });
});

test('slip: the verdict is slip', async () => {
  await drives();
  await press('Slip', /slip:/, {
    what: 'the verdict slip',
    find: (frame) => fusionOf(frame).find((record) => record.verdict === 'slip'),
  });
  await seeing(page, '#log', () => [...document.querySelectorAll('#log .text')].some((line) => /slip/i.test(line.textContent)));
  await recovered(tap.now_s);
});

test('camera late: fixes are applied late', async () => {
  await press('Camera late', /camera-delay:/, {
    what: 'a fix that is a quarter of a second late',
    find: (frame) => fixesOf(frame).find((fix) => fix.lag_s > 0.25),
  });
  await page.getByLabel('by ms').fill('0');
  await press('Camera late', /camera-delay:/, { what: 'a fix in time', find: (frame) => fixesOf(frame).find((fix) => fix.lag_s < 0.15) });
});

test('gyro bias step: the gyro disagrees with the wheels', async () => {
  const high = (record) => record.kind === 'wheel_angles' && record.dof > 0 && record.nis > 5.02;
  await press('Gyro bias step', /gyro-bias-step:/, {
    what: 'a wheel window whose NIS is outside its band',
    find: (frame) => fusionOf(frame).find(high),
    limit_s: WINDOWS_S,
  });
  await page.getByLabel('by °/s').fill('-3');
  await press('Gyro bias step', /gyro-bias-step:/, { what: 'what became of it', find: logs(/gyro-bias-step/) });
});

test('link: the link becomes as bad as the profile', async () => {
  await page.getByLabel('as bad as').selectOption('bluetooth-spp');
  await press('Link', /link-profile:/, { what: 'what became of it', find: logs(/link-profile/) });
  await page.getByLabel('as bad as').selectOption('');
  await press('Link', /link-profile:/, { what: 'what became of it', find: logs(/link-profile/) });
});

test('pull the cable: the link is down, and comes back', async () => {
  await page.getByLabel('for s').last().fill('1');
  const { begun_s } = await press('Pull the cable', /pull-cable:/, { what: 'a link that is down', find: logs(/link .* is down/) });
  await tap.until('the link again', logs(/link .* is up/), begun_s);
  await recovered(begun_s);
});

test('steering by odometry and by estimate is asked of the brick', async () => {
  for (const by of ['odometry', 'estimate']) {
    const begun_s = tap.now_s;
    // Not `check()`: the page shows what the station last said, which may still be the choice before.
    await page.getByLabel(by, { exact: true }).click();
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
  const moves = (estimate) => Math.abs(estimate.forward_m_per_s) > 0.02 || Math.abs(estimate.turn_rad_per_s) > 0.1;
  await press('Back to the path', /path/, { what: 'a robot that drives', find: (frame) => estimatesOf(frame).find(moves) });
});

test('a slider changes a parameter of the filter', async () => {
  // A panel out of sight is not drawn.
  await seen(page, '#parameters', '#parameter-gate_prob');
  const slider = page.getByLabel('gate_prob, slider');
  const begun_s = tap.now_s;
  await slider.focus();
  await slider.press('Home');
  const { found } = await tap.until('the parameter', (frame) => frame.parameters?.find(({ name, value }) => name === 'gate_prob' && value === 0.5), begun_s);
  assert.equal(found.value, 0.5);
  await slider.blur();
  await seeing(page, '#parameter-gate_prob', () => document.getElementById('parameter-gate_prob').value === '0.5');
  await page.getByLabel('gate_prob back to').click();
  await tap.until('the default', (frame) => frame.parameters?.find(({ name, value }) => name === 'gate_prob' && value === 0.999));
});

test('the recording so far is looked at again, beside the drive that goes on', async () => {
  const [first] = tap.frames.filter((frame) => estimatesOf(frame).length > 0);
  const [estimate] = estimatesOf(first);
  await seen(page, '#recordings', '[aria-label="Replay recording.mcap"]');
  await page.getByRole('button', { name: 'Replay recording.mcap' }).click();
  await page.getByRole('button', { name: 'Pause' }).click();
  await page.getByLabel('Time in the recording').fill(String(estimate.t_s + 0.001));
  await seeing(page, '#pose', (t_s) => Math.abs(Number(document.getElementById('pose').dataset.t_s) - t_s) < 0.2, estimate.t_s);
  const shown = await page.evaluate(() => ({ ...document.getElementById('pose').dataset }));
  const live = tap.frames.flatMap(estimatesOf).find(({ t_s }) => t_s === Number(shown.t_s));
  assert.ok(live, `the instant ${shown.t_s} was live as well`);
  assert.equal(Number(shown.x_m), live.x_m);
  await page.getByRole('button', { name: 'Back to live' }).click();
  await seeing(page, '#pose', (t_s) => Number(document.getElementById('pose').dataset.t_s) > t_s, estimate.t_s + 1);
});

test('after a reload the page shows what was switched and set', async () => {
  await seen(page, '#innovations', '[aria-label="Use accelerometer"]:enabled');
  const from_s = tap.now_s;
  await page.getByLabel('Use accelerometer').uncheck();
  await tap.until('a source that is left out', logs(/accelerometer.* is left out/), from_s);
  await page.getByLabel('as bad as').selectOption('usb');
  await press('Link', /link-profile: usb/, { what: 'what became of it', find: logs(/link-profile/) });
  await page.reload();
  await waitForState(page, 'live');
  await seeing(page, '#simulator', () => [...document.querySelectorAll('#simulator select')].some((select) => select.value === 'usb'));
  assert.equal(await page.getByLabel('as bad as').inputValue(), 'usb');
  await seeing(page, '#innovations', () => document.querySelector('[aria-label="Use accelerometer"]')?.checked === false);
  const box = page.getByLabel('Use accelerometer');
  assert.equal(await page.getByLabel('Use camera').isChecked(), true);
  const back_s = tap.now_s;
  await box.check();
  await tap.until('a source that is used', logs(/accelerometer.* is used/), back_s);
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
