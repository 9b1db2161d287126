// What the page costs: the first sight of it, its size, the server's share of a core, the screen's rate, and what further browsers do to the
// estimate. The station sends 50 estimates a second. Figures are printed; the bounds are the promises of docs/dashboard.md.

import assert from 'node:assert/strict';
import { writeFile } from 'node:fs/promises';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { WebSocket } from 'ws';
import { Browser } from './support/browser.mjs';
import { FakeStation } from './support/fake_station.mjs';
import { frameRate, heldBytes, residentBytes, threadSeconds } from './support/measure.mjs';
import { waitForState } from './support/page.mjs';
import { Program, newFolder } from './support/station.mjs';
import { Tap } from './support/tap.mjs';

const SCENARIO = 'seed = 1\nsteering = "estimate"\n[path.square]\nside_m = 1.0\n[brick]\ntelemetry_hz = 50\n';
const FIRST_CONTENT_MS = 300;
const TRANSFER_BYTES = 300_000;
const SERVER_SHARE = 0.1;
const SERVER_THREADS = 'dashboard';
const LOOK_S = 5;
// A page that blocks the screen falls far below this; what it reaches is printed.
const LEAST_FRAMES_PER_S = 30;
// An estimate takes some tenths of a millisecond inside the station: nine more readers may cost it one more at most, in the mean.
const LATENCY_GROWTH_MS = 1;
const READERS = 10;
const SOAK_S = Number(process.env.BROWSER_SOAK_S ?? 10);
const SOAK_GROWTH_BYTES = 2_000_000;
// A long run begins when everything is full: tracks of learned numbers hold five minutes, and the simulated brick remembers ten of the
// truth. From then on nothing may grow.
const LONG_S = 600;
const FULL_S = 660;
const STATION_GROWTH = 0.05;
// Less than six bytes for each message: smaller than any object that one of them could leave behind.
const HELD_GROWTH = 0.02;
const WHAT = { held: 'what the page holds', station: 'the station' };

let station;
let browser;
let page;
let tap;

before(async () => {
  const folder = await newFolder();
  await writeFile(path.join(folder, 'fifty.toml'), SCENARIO);
  station = Program.start(['run', '--link', 'sim://fifty.toml', '--out', 'session', '--dashboard', '127.0.0.1:0'], folder);
  browser = await Browser.launch();
});

after(async () => {
  await browser?.close();
  await station?.remove();
});

test('the first content is there within 300 ms, and all of it is small', async (context) => {
  tap = new Tap();
  const sizes = [];
  const address = await station.address();
  // The second sight: the first one of a browser pays for starting its own processes.
  const warm = await browser.open(address);
  await waitForState(warm, 'live');
  await warm.close();
  page = await browser.open('about:blank', { own: new URL(address).origin, tap });
  const session = await page.context().newCDPSession(page);
  await session.send('Network.enable');
  await session.send('Network.setCacheDisabled', { cacheDisabled: true });
  session.on('Network.loadingFinished', ({ encodedDataLength }) => sizes.push(encodedDataLength));
  await page.goto(address);
  await waitForState(page, 'live');
  await page.waitForFunction(() => performance.getEntriesByName('first-contentful-paint').length > 0);
  const paint_ms = await page.evaluate(() => performance.getEntriesByName('first-contentful-paint')[0].startTime);
  const bytes = sizes.reduce((sum, size) => sum + size, 0);
  await session.detach();
  context.diagnostic(`first content after ${paint_ms.toFixed(0)} ms, ${sizes.length} files, ${(bytes / 1000).toFixed(1)} kB over the wire`);
  assert.ok(sizes.length > 20, 'files were seen');
  assert.ok(bytes < TRANSFER_BYTES, `${bytes} bytes`);
  assert.ok(paint_ms < FIRST_CONTENT_MS, `${paint_ms} ms`);
});

test('at 50 estimates a second the server takes less than a tenth of a core, and the page keeps up with the screen', async (context) => {
  const begun = await threadSeconds(station.pid, SERVER_THREADS);
  assert.ok(begun.names.some((name) => name.startsWith(SERVER_THREADS)), `threads: ${begun.names}`);
  const from_s = tap.now_s;
  const counted = tap.frames.length;
  const [rate] = await Promise.all([frameRate(page, 1000 * (LOOK_S - 1)), tap.pass(LOOK_S)]);
  const ended = await threadSeconds(station.pid, SERVER_THREADS);
  const span_s = tap.now_s - from_s;
  const share = (ended.seconds - begun.seconds) / span_s;
  const estimates = tap.frames.slice(counted).reduce((sum, frame) => sum + frame.robots.reduce((all, robot) => all + robot.estimates.length, 0), 0);
  context.diagnostic(`server ${(100 * share).toFixed(1)} % of a core at ${(estimates / span_s).toFixed(0)} estimates a second; page ${rate.per_s.toFixed(1)} frames/s, ${rate.long} over 50 ms`);
  assert.ok(estimates / span_s > 40, `${estimates} estimates in ${span_s} s`);
  assert.ok(share < SERVER_SHARE, `${share} of a core`);
  assert.ok(rate.per_s > LEAST_FRAMES_PER_S, `${rate.per_s} frames/s`);
});

for (const count of [30, 64]) {
  test(`the page keeps up with ${count} robots`, async (context) => {
    const many = new FakeStation({ robots: Array.from({ length: count }, (_, index) => `0/${index + 1}/1`) });
    await many.open();
    const shown = await browser.open(many.address);
    await waitForState(shown, 'live');
    // Trails of some length: it is them that cost.
    for (let batch = 0; batch < 6; batch += 1) many.advance(100);
    await shown.waitForFunction((t_s) => Number(document.getElementById('pose').dataset.t_s) === t_s, many.now_s);
    const session = await shown.context().newCDPSession(shown);
    await session.send('Performance.enable');
    const busy_s = async () => (await session.send('Performance.getMetrics')).metrics.find(({ name }) => name === 'TaskDuration').value;
    const before_s = await busy_s();
    const sending = setInterval(() => many.advance(1), 20);
    const rate = await frameRate(shown, 1000 * LOOK_S);
    clearInterval(sending);
    const share = (await busy_s() - before_s) / LOOK_S;
    context.diagnostic(`${rate.per_s.toFixed(1)} frames/s, ${rate.long} over 50 ms, ${(100 * share).toFixed(0)} % of a core; ${((await heldBytes(shown)) / 1e6).toFixed(0)} MB`);
    await shown.close();
    await many.close();
    assert.ok(rate.per_s > LEAST_FRAMES_PER_S, `${rate.per_s} frames/s`);
  });
}

test('the second and the tenth browser leave the latency of the estimate as it is', async (context) => {
  const one = await meanLatency_ms();
  const second = await browser.open(await station.address());
  await waitForState(second, 'live');
  const two = await meanLatency_ms();
  // For the server a reader of the stream is a browser; for this computer it is not one more program that draws.
  const readers = await Promise.all(Array.from({ length: READERS - 2 }, reader));
  const ten = await meanLatency_ms();
  context.diagnostic(`mean latency of an estimate: ${one.toFixed(3)} ms with one browser, ${two.toFixed(3)} ms with two, ${ten.toFixed(3)} ms with ten`);
  for (const { socket, count } of readers) {
    assert.ok(count.frames > LOOK_S * 20, `a reader got ${count.frames} messages`);
    socket.terminate();
  }
  await second.close();
  for (const more of [two, ten]) assert.ok(more - one < LATENCY_GROWTH_MS, `${more} ms against ${one} ms`);
});

async function reader() {
  const socket = new WebSocket(`${(await station.address()).replace('http', 'ws')}v1/stream`);
  const count = { frames: 0 };
  socket.on('message', () => { count.frames += 1; });
  await new Promise((resolve, reject) => { socket.on('open', resolve).on('error', reject); });
  return { socket, count };
}

// Over some seconds of the session, from the sums that /metrics gives.
async function meanLatency_ms() {
  const from = await latencySums();
  await tap.pass(LOOK_S);
  const to = await latencySums();
  assert.ok(to.count > from.count);
  return (1000 * (to.sum_s - from.sum_s)) / (to.count - from.count);
}

async function latencySums() {
  const text = await (await fetch(`${await station.address()}metrics`)).text();
  const read = (name) => Number(new RegExp(`^posebridge_estimate_latency_seconds_${name}(?:{.*})? (.+)$`, 'm').exec(text)?.[1]);
  const sums = { sum_s: read('sum'), count: read('count') };
  assert.ok(Number.isFinite(sums.sum_s) && Number.isFinite(sums.count), text);
  return sums;
}

test(`the memory of page and station is flat over ${SOAK_S} s`, async (context) => {
  const isLong = SOAK_S >= LONG_S;
  if (isLong) await passing(FULL_S);
  const begun = await memory();
  await passing(SOAK_S);
  const ended = await memory();
  for (const [who, what] of Object.entries(WHAT)) context.diagnostic(`${what}: ${(begun[who] / 1e6).toFixed(2)} MB, then ${(ended[who] / 1e6).toFixed(2)} MB`);
  assert.ok(ended.held - begun.held < SOAK_GROWTH_BYTES, WHAT.held);
  if (isLong) {
    assert.ok(ended.held < (1 + HELD_GROWTH) * begun.held, WHAT.held);
    assert.ok(ended.station < (1 + STATION_GROWTH) * begun.station, WHAT.station);
  }
});

async function memory() {
  return { held: await heldBytes(page), station: await residentBytes(station.pid) };
}

async function passing(seconds) {
  const until_s = tap.now_s + seconds;
  while (tap.now_s < until_s) await tap.pass(Math.min(10, until_s - tap.now_s));
}
