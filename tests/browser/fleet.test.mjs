// The fleet on the page: its robots in a table and on the map, and commands for those of other stations. The stations are made up.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { FakeStation, fleetOf } from './support/fake_station.mjs';
import { seeing, waitForState } from './support/page.mjs';

let browser;

before(async () => {
  browser = await Browser.launch();
});

after(() => browser.close());

async function withStation(change, body) {
  const station = new FakeStation();
  change(station);
  await station.open();
  // The test reads the map's pixels, the page does not.
  const page = await browser.open(station.address, { forgives: ['status of 400', 'willReadFrequently'] });
  try {
    await waitForState(page, 'live');
    station.advance(60);
    await body(page, station);
  } finally {
    await page.close();
    await station.close();
  }
}

const inFleet = (station) => { station.fleet = fleetOf(); };
const cellsOf = (page, name) => page.locator('#fleet tbody tr', { hasText: name }).locator('td').allTextContents();

async function listed(page) {
  await seeing(page, '#fleet', () => document.querySelectorAll('#fleet tbody tr').length === 4);
}

test('a station of its own has no panel of a fleet', async () => {
  await withStation(() => {}, async (page) => {
    await seeing(page, '#arena', () => document.getElementById('pose').dataset.x_m !== undefined);
    assert.equal(await page.locator('#fleet').isVisible(), false);
  });
});

test('all robots of the fleet are listed with owner, age, losses and pose', async () => {
  await withStation(inFleet, async (page) => {
    await listed(page);
    assert.equal(await page.locator('#fleet .body > .note').first().textContent(), 'class: left (this station, 1 robot), right (clock known to 0.4 ms, 2 robots)');
    const [owner, age, transit, lost, position, heading] = await cellsOf(page, 'bob');
    assert.deepEqual([owner, transit, lost, position, heading], ['right', '3.1 ms', '7, 3 of earlier owners', '0.50, 0.50 m', '29°']);
    assert.equal(age, '20 ms');
    assert.equal((await cellsOf(page, 'ada'))[0], 'left (this station)');
    const [nobody, , untimed, , start, unknown] = await cellsOf(page, 'eve');
    assert.deepEqual([nobody, untimed, start, unknown], ['nobody', '–', 'from its start', '–']);
    assert.equal((await cellsOf(page, 'eva'))[4], 'no estimate');
    // Those of other stations have buttons; that of this station has its controls elsewhere, and for one that nobody owns there is nobody to ask.
    const buttons = await page.locator('#fleet tbody button:visible').evaluateAll((all) => all.map((one) => one.getAttribute('aria-label')));
    assert.deepEqual(buttons, ['Reset pose of bob', 'Set pose of bob', 'Reset pose of eva', 'Set pose of eva']);
  });
});

test('robots of other stations are on the map, and move with the next answer', async () => {
  await withStation(inFleet, async (page, station) => {
    await listed(page);
    const drawn = () => page.evaluate(() => new Promise((resolve) => {
      document.getElementById('arena').scrollIntoView();
      requestAnimationFrame(() => {
        const canvas = document.querySelector('#arena canvas');
        const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
        resolve(data.reduce((sum, value) => (sum * 31 + value) % 1000000007, 0));
      });
    }));
    const until = async (holds) => {
      let [last, now] = [NaN, await drawn()];
      while (!holds(now, last)) [last, now] = [now, await drawn()];
      return now;
    };
    // The robot of this station stands still from here on.
    const before = await until((now, last) => now === last);
    station.fleet = fleetOf({ x_m: 1.25 });
    await until((now) => now !== before);
    station.fleet = fleetOf();
    await until((now) => now === before);
  });
});

test('commands for a robot of another station name it, and a refusal of its owner is shown', async () => {
  await withStation(inFleet, async (page, station) => {
    await listed(page);
    await page.getByRole('button', { name: 'Reset pose of bob' }).click();
    assert.deepEqual(await station.until((commands) => commands.length === 1), { command: 'reset-pose', fleet_robot: 'bob' });
    await page.getByRole('button', { name: 'Set pose of bob', exact: true }).click();
    const form = page.locator('#fleet .set-pose');
    assert.equal(await form.locator('h3').textContent(), 'Set the pose of bob');
    const fields = form.locator('input');
    assert.deepEqual(await fields.evaluateAll((all) => all.map((one) => one.value)), ['0.5', '0.5', '28.65']);
    await fields.nth(2).fill('90');
    await form.getByRole('button', { name: 'Set', exact: true }).click();
    const sent = await station.until((commands) => commands.length === 2);
    assert.deepEqual({ ...sent, heading_rad: sent.heading_rad.toFixed(4) }, {
      command: 'set-pose', fleet_robot: 'bob', x_m: 0.5, y_m: 0.5, heading_rad: '1.5708', position_sigma_m: 0.05, heading_sigma_rad: sent.heading_sigma_rad,
    });
    await page.waitForFunction(() => document.querySelector('#fleet .set-pose').hidden);
    station.refusal = 'the robot\'s station does not know the operator\'s token of this station';
    await page.getByRole('button', { name: 'Reset pose of bob' }).click();
    await page.waitForFunction(() => document.querySelector('#announcer.error')?.textContent.includes('operator\'s token'));
  });
});

test('who may only look has the list and no buttons', async () => {
  await withStation((station) => { inFleet(station); station.canCommand = false; }, async (page) => {
    await listed(page);
    assert.equal(await page.locator('#fleet tbody button:visible').count(), 0);
  });
});
