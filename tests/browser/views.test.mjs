// Every view of the page: axe-core finds nothing, and on a phone nothing scrolls sideways and everything can be hit by a finger.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { findings } from './support/axe.mjs';
import { Browser } from './support/browser.mjs';
import { FakeStation, fleetOf } from './support/fake_station.mjs';
import { seeing, waitForState } from './support/page.mjs';

const PHONE = { width: 360, height: 740 };
const DESK = { width: 1440, height: 1000 };
// WCAG 2.2, criterion 2.5.8.
const LEAST_TARGET_PX = 24;
const ARENA = { landmarks: [{ id: 6, x_m: 1.2, y_m: 0.4 }], beacons: [{ id: 2, x_m: -0.3, y_m: 0.9 }], walls: [[[-0.4, -0.3], [1.4, -0.3]]] };

let browser;

before(async () => {
  browser = await Browser.launch();
});

after(() => browser.close());

async function driven(page, station) {
  station.advance(150);
  await page.waitForFunction((t_s) => Number(document.getElementById('pose').dataset.t_s) === t_s, station.now_s);
}

async function replayed(page, station) {
  await driven(page, station);
  const made = new FakeStation();
  const estimates = Array.from({ length: 200 }, (_, index) => {
    made.now_s = index / 50;
    return made.frame().robots[0].estimates[0];
  });
  station.replay = { now_s: 4, robots: [{ id: '0/1/1', estimates }], log: [{ t_s: 1, severity: 4, text: 'a warning' }] };
  await seeing(page, '#recordings', () => document.querySelector('[aria-label="Replay square-1.mcap"]') !== null);
  await page.getByRole('button', { name: 'Replay square-1.mcap' }).click();
  await page.getByRole('button', { name: 'Pause' }).click();
}

const VIEWS = {
  'without a robot': { options: { robots: [] } },
  'with a simulated robot': { reach: driven },
  'with a real robot': { reach: driven, real: true },
  'with several robots, one of them silent': {
    options: { robots: ['0/1/1', '0/2/1'], names: { '0/2/1': 'right' } },
    async reach(page, station) {
      await driven(page, station);
      station.robots = ['0/1/1'];
      station.advance(100);
      await seeing(page, '#robots', () => document.querySelector('tr[data-state="silent"]') !== null);
    },
  },
  'with filters, a quantity and thermometers': {
    async reach(page, station) {
      await driven(page, station);
      const row = { error_m: 0.01, error_rms_m: 0.02, apart_m: 0, major_m: 0.03, nis: 1, used: 9, gated: 0 };
      const quantity = (name, kind, unit) => ({ t_s: station.now_s, name, kind, unit, reading: 1.2, verdict: 'gated', estimate: 1.3, bound_95: 0.1, rate_per_s: -0.2, steps: 9, predicted: 3 });
      station.send({ type: 'frame', now_s: station.now_s, robots: [{ id: '0/1/1', comparison: ['', 'ekf5'].map((filter) => ({ ...row, filter })), quantities: [quantity('', 'wall_range', 'm'), quantity('water', 'temperature', '°C')] }] });
      await seeing(page, '#thermometers', () => document.querySelector('#thermometers tbody tr') !== null);
    },
  },
  'while a pose is asked for': {
    real: true,
    async reach(page, station) {
      await driven(page, station);
      await page.getByText('Set the pose in numbers').click();
      await page.getByRole('button', { name: 'Set pose' }).click();
    },
  },
  'while keys drive, and after a refusal': {
    options: { forgives: ['status of 400'] },
    async reach(page, station) {
      await driven(page, station);
      await page.getByRole('button', { name: 'Drive with the keys' }).click();
      station.refusal = 'forward_m is 900, must lie in -100 to 100';
      await page.getByRole('button', { name: 'Kidnap', exact: true }).click();
      await page.waitForFunction(() => document.querySelector('#announcer.error') !== null);
    },
  },
  'in a fleet, while the pose of another station\'s robot is set': {
    fleet: fleetOf(),
    async reach(page, station) {
      await driven(page, station);
      await seeing(page, '#fleet', () => document.querySelector('[aria-label="Set pose of bob"]') !== null);
      await page.getByRole('button', { name: 'Set pose of bob', exact: true }).click();
    },
  },
  'in a replay': { reach: replayed },
  'zoomed, with the cursor in a chart': {
    async reach(page, station) {
      await driven(page, station);
      await page.locator('#innovations').scrollIntoViewIfNeeded();
      await seeing(page, '#innovations', () => document.querySelector('#innovations .u-over') !== null);
      const { x, y, width, height } = await page.locator('#innovations .u-over').first().boundingBox();
      await page.mouse.move(x + width / 2, y + height / 2);
      await page.mouse.down();
      await page.mouse.move(x + 0.8 * width, y + height / 2, { steps: 3 });
      await page.mouse.up();
      await page.waitForFunction(() => document.getElementById('time-span').textContent.includes('double-click'));
    },
  },
  'when the station is gone': {
    options: { forgives: ['WebSocket connection', 'ERR_CONNECTION_REFUSED'] },
    async reach(page, station) {
      await driven(page, station);
      await station.close();
      await seeing(page, '#arena', () => document.querySelector('#pose.stale') !== null && document.getElementById('connection-age').textContent !== '');
    },
  },
};

for (const [name, { options = {}, real = false, fleet = null, reach }] of Object.entries(VIEWS)) {
  test(`${name}: accessible in light and dark, and usable on a phone`, async () => {
    const station = new FakeStation(options);
    if (real) station.simulator = null;
    station.arena = ARENA;
    station.fleet = fleet;
    await station.open();
    const page = await browser.open(station.address, options);
    try {
      await page.setViewportSize(DESK);
      await waitForState(page, 'live');
      await reach?.(page, station);
      const found = [];
      for (const [colorScheme, size] of [['light', DESK], ['dark', DESK], ['light', PHONE]]) {
        await page.emulateMedia({ colorScheme, reducedMotion: 'reduce' });
        await page.setViewportSize(size);
        await seeEverything(page);
        found.push(...(await findings(page)).map((finding) => `${colorScheme}, ${size.width} px: ${finding}`));
      }
      assert.deepEqual(found, []);
      assert.deepEqual(await page.evaluate(tooSmall, LEAST_TARGET_PX), []);
      assert.ok(await page.evaluate(() => document.documentElement.scrollWidth) <= PHONE.width, await page.evaluate(() => document.documentElement.scrollWidth));
    } finally {
      await page.close();
      await station.close().catch(() => {});
    }
  });
}

// A panel is drawn when it is seen, and panels take turns: one a frame of the screen.
async function seeEverything(page) {
  await page.evaluate(async () => {
    for (const panel of document.querySelectorAll('.panel:not([hidden])')) {
      panel.scrollIntoView({ block: 'center' });
      for (let frame = 0; frame < 6; frame += 1) await new Promise(requestAnimationFrame);
    }
    scrollTo(0, 0);
  });
}

// Runs in the page: what can be worked and is smaller than a finger needs. The label of a box or a button of a group belongs to it.
function tooSmall(least_px) {
  const sizeOf = (node) => {
    const boxes = [node, ...(node.labels ?? [])].map((one) => one.getBoundingClientRect());
    return Math.min(Math.max(...boxes.map(({ width }) => width)), Math.max(...boxes.map(({ height }) => height)));
  };
  return [...document.querySelectorAll('button, a[href]:not(.skip), input, select, summary, [role="slider"]')]
    .filter((node) => node.getClientRects().length > 0 && sizeOf(node) < least_px - 0.5)
    .map((node) => `${sizeOf(node).toFixed(0)} px: ${node.outerHTML.slice(0, 120)}`);
}
