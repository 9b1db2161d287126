// The time axis that all charts share, on a made-up station: one instant, one span, live and in a replay.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { FakeStation } from './support/fake_station.mjs';
import { seeing, waitForState } from './support/page.mjs';

const RUN_S = 150;
const BATCH = 250;

let browser;
let station;
let page;
const sent = [];

before(async () => {
  browser = await Browser.launch();
  station = new FakeStation();
  await station.open();
  page = await browser.open(station.address);
  await page.setViewportSize({ width: 1440, height: 2400 });
  await waitForState(page, 'live');
  for (let batch = 0; batch < (50 * RUN_S) / BATCH; batch += 1) {
    for (let frame = 0; frame < BATCH; frame += 1) {
      station.advance(1);
      sent.push(station.frame());
    }
    await page.waitForFunction((t_s) => Number(document.getElementById('pose').dataset.t_s) === t_s, station.now_s);
  }
  await seeing(page, '#calibration', () => document.querySelectorAll('#calibration .chart canvas').length === 2);
});

after(async () => {
  await browser.close();
  await station.close();
});

const overChart = (panel, nth = 0) => page.locator(`#${panel} .u-over`).nth(nth);

// Points at a share of a chart's width.
async function pointAt(panel, share, nth = 0) {
  const { x, y, width, height } = await overChart(panel, nth).boundingBox();
  await page.mouse.move(x + share * width, y + height / 2);
}

// Points until all charts say something of the instant that fits: a chart takes over another span some frames after the bar has said so.
async function pointing(panel, share, pattern) {
  for (let tried = 0; tried < 100; tried += 1) {
    await pointAt(panel, share + 1e-4 * tried);
    const texts = await readouts();
    if (texts.length >= 7 && texts.every((text) => pattern.test(text))) return texts;
  }
  return assert.fail(`${pattern} in ${await readouts()}`);
}

// What the charts say, some frames of the screen from now.
function readouts() {
  return page.evaluate(() => new Promise((done) => {
    let frames = 20;
    const step = () => {
      frames -= 1;
      if (frames > 0) requestAnimationFrame(step);
      else done([...document.querySelectorAll('#error .at, #innovations .at, #calibration .at')].map((node) => node.textContent));
    };
    step();
  }));
}

const spanIs = (pattern) => page.waitForFunction((wanted) => new RegExp(wanted).test(document.getElementById('time-span').textContent), pattern);

test('all charts show the values of the instant that somebody points at in one of them', async () => {
  assert.equal(await page.locator('#time-span').textContent(), 'Charts: last 60 s');
  assert.equal(await page.getByRole('button', { name: 'Last minute' }).getAttribute('aria-pressed'), 'true');
  const texts = await pointing('error', 0.5, /^(1:59|2:00)\.\d/);
  assert.equal(new Set(texts.map((text) => text.split(' ')[0])).size, 1, texts.join('; '));
  const [, odometry, estimate] = texts[0].match(/odometry ([\d.]+ \w+), estimate ([\d.]+) mm$/) ?? assert.fail(texts[0]);
  assert.match(odometry, /mm|m/);
  const near = sent.filter(({ now_s }) => Math.abs(now_s - (RUN_S - 30)) < 0.4).map((frame) => 1000 * frame.robots[0].scores[0].estimate_m);
  assert.ok(estimate >= Math.min(...near) - 0.1 && estimate <= Math.max(...near) + 0.1, `${estimate} mm in ${near}`);
  assert.ok(texts.some((text) => /used [-\d.]+ mm, 2 σ \d+/.test(text)) && texts.some((text) => / ± /.test(text)), texts.join('; '));
  // Every chart has its line there.
  const lines = await page.locator('.chart .u-cursor-x:not(.u-off)').count();
  assert.equal(lines, texts.length);
  // The cursor stays with its instant while the charts go on.
  station.advance(100);
  await page.waitForFunction((t_s) => Number(document.getElementById('pose').dataset.t_s) === t_s, station.now_s);
  assert.deepEqual(new Set((await readouts()).map((text) => text.split(' ')[0])), new Set([texts[0].split(' ')[0]]));
  await page.mouse.move(2, 2);
  assert.deepEqual(new Set(await readouts()), new Set(['']));
});

test('the whole run is there from its first second, by a button', async () => {
  await page.getByRole('button', { name: 'Whole run' }).press('Enter');
  await spanIs('^Charts: whole run, 0:00 to 2:32$');
  const texts = await pointing('error', 0.01, /^0:0[123]\.\d/);
  assert.ok(texts.every((text) => !text.includes('no data')), texts.join('; '));
  await page.getByRole('button', { name: 'Last minute' }).click();
  await spanIs('last 60 s');
});

test('a drag in one chart is the span of all, until a double click', async () => {
  await pointing('innovations', 0.25, /^1:4[678]\.\d/);
  const { x, y, width, height } = await overChart('innovations', 1).boundingBox();
  await page.mouse.move(x + 0.25 * width, y + height / 2);
  await page.mouse.down();
  await page.mouse.move(x + 0.5 * width, y + height / 2, { steps: 4 });
  // The span stands still under the pointer.
  station.advance(50);
  await page.mouse.up();
  await spanIs('^Charts: 1:4[678] to 2:0[123]');
  await pointing('error', 0.5, /^1:5[3456]\.\d/);
  await overChart('error').dblclick();
  await spanIs('^Charts: last 60 s$');
});

test('in a replay the whole run is the recording, with the instant that is shown', async () => {
  const frames = sent.slice(0, 5000);
  const all = (read) => frames.flatMap((frame) => read(frame.robots[0]));
  station.replay = { now_s: 100, robots: [{ id: '0/1/1', estimates: all((robot) => robot.estimates), scores: all((robot) => robot.scores), fusion: all((robot) => robot.fusion), calibration: all((robot) => (robot.calibration ?? []).map((row) => ({ t_s: robot.estimates[0].t_s, ...row }))) }] };
  await page.getByRole('button', { name: 'Replay square-1.mcap' }).click();
  await page.getByRole('button', { name: 'Pause' }).click();
  await page.getByLabel('Time in the recording').fill('80');
  await spanIs('^Charts: last 60 s$');
  await pointing('error', 0.5, /^0:(49|50)\.\d  /);
  assert.match((await readouts())[0], /estimate/);
  await page.getByRole('button', { name: 'Whole run' }).click();
  await spanIs('^Charts: whole run, 0:00 to 1:40$');
  const texts = await pointing('error', 0.9, /^1:(29|30)\.\d  /);
  assert.match(texts[0], /estimate/);
});
