// A real robot's page: a LEGO brick that no camera sees, over a TCP link, with the real program on both ends.

import assert from 'node:assert/strict';
import { readFile, writeFile } from 'node:fs/promises';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { poseOf, seeing, waitForState } from './support/page.mjs';
import { Program, newFolder } from './support/station.mjs';

const SOON_S = 3;

let browser;

before(async () => {
  browser = await Browser.launch();
});

after(() => browser.close());

async function startBrick(kind, port) {
  return Program.start(['sim', 'square', '--brick', kind, '--listen', `tcp://127.0.0.1:${port}`], await newFolder());
}

// Runs `use(page, station, folder, {brick, port})` with a brick that stands in for a real one: the station knows nothing of a simulator.
function withBrick(use, ...args) {
  return withRobot('nxt', null, use, ...args);
}

// The same with a brick of a kind, and a configuration.
async function withRobot(kind, config, use, ...args) {
  const brick = await startBrick(kind, 0);
  const [, port] = await brick.finds(/listening on 127\.0\.0\.1:(\d+)/);
  const folder = await newFolder();
  if (config !== null) {
    await writeFile(path.join(folder, 'robot.toml'), config);
    args.push('--config', 'robot.toml');
  }
  const station = Program.start(['run', ...(kind === 'nxt' ? ['--brick', 'nxt'] : []), '--link', `tcp://127.0.0.1:${port}`, '--out', 'session', '--events', 'events.jsonl', '--dashboard', '127.0.0.1:0', ...args], folder);
  try {
    // The test reads the map's pixels, the page does not.
    const page = await browser.open(await station.address(), { forgives: ['willReadFrequently'] });
    await waitForState(page, 'live');
    await use(page, station, folder, { brick, port });
    await page.close();
  } finally {
    await station.remove();
    await brick.remove();
  }
}

async function eventsOf(folder, name) {
  const lines = (await readFile(path.join(folder, 'events.jsonl'), 'utf8')).split('\n').filter(Boolean);
  return lines.map((line) => JSON.parse(line)).filter(({ event }) => event === name);
}

const hasPose = () => document.getElementById('pose').dataset.x_m !== undefined;

test('a robot that nobody sees has numbers at once, counted from its start', async () => {
  await withBrick(async (page, station, folder) => {
    await seeing(page, '#pose', hasPose);
    const first = await poseOf(page);
    assert.equal(first.is_relative, 1);
    assert.match(await page.locator('#pose').textContent(), /relative toits start/);
    assert.match(await page.locator('#headline').textContent(), /relative to where it started$/);
    // Of a real robot nobody knows the truth, and there is no brick to play with.
    for (const id of ['simulator', 'error']) assert.equal(await page.locator(`#${id}`).isVisible(), false, id);
    assert.equal(await page.locator('.legend li:visible').filter({ hasText: 'truth' }).count(), 0);
    // But where its wheels alone say it is; nothing stands in its arena.
    await seeing(page, '#pose', () => [...document.querySelectorAll('.legend li:not([hidden])')].some((item) => item.textContent === 'odometry'));
    assert.equal(await page.locator('.legend li:visible').filter({ hasText: /wall|landmark|beacon/ }).count(), 0);
    await seeing(page, '#pose', () => Math.abs(Number(document.getElementById('pose').dataset.x_m)) > 0.1);
    assert.equal(await station.stop(), 0);
    const [heard] = (await eventsOf(folder, 'observed')).filter(({ kind }) => kind === 'wheel_angles');
    assert.ok(first.t_s - heard.arrival_host_ns / 1e9 < SOON_S, `${first.t_s} s, heard at ${heard.arrival_host_ns} ns`);
  });
});

test('a pose is set by dragging on the map, and in numbers', async () => {
  await withBrick(async (page, station) => {
    await seeing(page, '#pose', hasPose);
    await page.getByRole('button', { name: 'Set pose' }).click();
    const map = page.locator('#arena canvas').first();
    const { width, height } = await map.boundingBox();
    const [x, y] = [0.4 * width, 0.6 * height];
    // The list above the map may change its height: where the map is now counts, and not where it was.
    await map.hover({ position: { x, y } });
    await page.mouse.down();
    const box = await map.boundingBox();
    await page.mouse.move(box.x + x, box.y + y - 60, { steps: 4 });
    await page.mouse.up();
    // Upwards on the map is north.
    await seeing(page, '#pose', () => document.getElementById('pose').dataset.is_relative === '0');
    const dragged = await poseOf(page);
    assert.equal(dragged.reset_counter, 1);
    assert.equal(await page.getByRole('button', { name: 'Set pose' }).getAttribute('aria-pressed'), 'false');
    // The map may move a little below the pointer, because the robot drives.
    const [, heading_deg] = await station.finds(/pose set to x -?\d+\.\d+ m, y -?\d+\.\d+ m, (-?\d+\.\d) deg/);
    assert.ok(Math.abs(heading_deg - 90) < 20, heading_deg);
    await page.getByText('Set the pose in numbers').click();
    const fields = page.locator('.set-pose input');
    for (const [index, value] of ['4', '5', '-90'].entries()) await fields.nth(index).fill(value);
    await page.getByRole('button', { name: 'Set', exact: true }).click();
    await seeing(page, '#pose', () => Number(document.getElementById('pose').dataset.reset_counter) === 2);
    const typed = await poseOf(page);
    assert.ok(Math.hypot(typed.x_m - 4, typed.y_m - 5) < 0.5, `${typed.x_m} ${typed.y_m}`);
    assert.equal(await station.stop(), 0);
  });
});

test('--set-pose is a command at the first estimate', async () => {
  await withBrick(async (page, station) => {
    await seeing(page, '#pose', () => document.getElementById('pose').dataset.is_relative === '0');
    const { x_m, y_m } = await poseOf(page);
    assert.ok(Math.hypot(x_m + 2, y_m - 3) < 1, `${x_m} ${y_m}`);
    await station.finds(/pose set to x -2\.000 m, y 3\.000 m, 90\.0 deg/);
    assert.equal(await station.stop(), 0);
  }, '--set-pose', '-2,3,90');
});

test('the set-up checklist is red while the link is pulled, and gone when all is well', async () => {
  const stepsAre = (page, expected) => page.waitForFunction((wanted) => {
    const lines = [...document.querySelectorAll('.setup li')];
    const found = (name) => lines.find((line) => line.querySelector('.step').textContent === name)?.dataset.state;
    return Object.entries(wanted).every(([name, state]) => found(name) === state);
  }, expected);
  await withBrick(async (page, station, folder, { brick, port }) => {
    const list = page.locator('#setup');
    await list.waitFor({ state: 'visible' });
    await list.waitFor({ state: 'hidden' });
    await brick.remove();
    await stepsAre(page, { 'link open': 'problem', 'bytes come': 'problem', 'wheel counts move': 'problem' });
    const line = page.locator('.setup li', { hasText: 'link open' });
    assert.equal(await line.isVisible(), true);
    assert.match(await line.textContent(), /posebridge doctor/);
    const again = await startBrick('nxt', port);
    try {
      await list.waitFor({ state: 'hidden' });
      assert.equal(await station.stop(), 0);
    } finally {
      await again.remove();
    }
  });
});

const ARENA = `
[world]
landmarks = [{ id = 6, x_m = 1.2, y_m = 0.4 }]
beacons = [{ id = 2, x_m = -0.3, y_m = 0.9 }]
walls = [{ from = { x_m = -0.4, y_m = -0.3 }, to = { x_m = 1.4, y_m = -0.3 } }]
`;

// Runs in the page: whether all of these colours of the palette are drawn on the map.
function areOnMap(names) {
  const canvas = document.querySelector('.map canvas');
  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  return names.every((name) => {
    const hex = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
    const colour = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
    for (let at = 0; at < data.length; at += 4) {
      if (data[at + 3] > 200 && colour.every((part, index) => Math.abs(part - data[at + index]) < 12)) return true;
    }
    return false;
  });
}

test('the map of a real robot has odometry, fixes and what stands in the arena, live and in a replay', async () => {
  await withRobot('mavlink', ARENA, async (page, station) => {
    const wanted = ['estimate', 'odometry', 'accepted', 'wall', 'place'];
    await seeing(page, '#arena', areOnMap, wanted);
    const texts = await page.locator('.legend li:visible').allTextContents();
    assert.deepEqual(texts.slice(0, 5), ['odometry', 'estimate, 95 % ellipse, heading cone', 'wall', 'landmark', 'beacon']);
    const state = await page.evaluate(async () => (await (await fetch('v1/state')).json()).robots[0]);
    assert.equal(state.truth, null, 'nobody knows the truth');
    // The station learns a robot's geometry once a second: the odometry of a shorter recording may not have begun.
    await seeing(page, '#pose', () => Number(document.getElementById('pose').dataset.t_s) > 4);
    await page.getByRole('button', { name: 'Stop the recording' }).click();
    await seeing(page, '#recordings', () => document.getElementById('recording-state').textContent === 'Not recording.');
    await page.getByRole('button', { name: /^Replay / }).first().click();
    await page.getByRole('button', { name: 'Pause' }).click();
    const scrubber = page.getByLabel('Time in the recording');
    await scrubber.fill(await scrubber.getAttribute('max'));
    await seeing(page, '#arena', areOnMap, wanted);
    assert.equal(await station.stop(), 0);
  });
});
