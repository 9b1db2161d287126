// The page on a made-up station: what the program never says or does on demand. Everything here moves by the station's frames, not by time.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { FakeStation } from './support/fake_station.mjs';
import { poseOf, seeing, seen, waitForState } from './support/page.mjs';

let browser;

before(async () => {
  browser = await Browser.launch();
});

after(() => browser.close());

async function withStation(options, body) {
  const station = new FakeStation(options);
  await station.open();
  const page = await browser.open(station.address, options);
  try {
    await waitForState(page, 'live');
    await body(page, station);
  } finally {
    await page.close();
    await station.close();
  }
}

// The last command that came, when there are this many.
function lastOf(station, count) {
  return station.until((commands) => commands.length >= count);
}

test('the latest estimate stands on the page', async () => {
  await withStation({}, async (page, station) => {
    station.advance(120);
    await page.waitForFunction((t_s) => Number(document.getElementById('pose').dataset.t_s) === t_s, station.now_s);
    const pose = await poseOf(page);
    const [estimate] = station.frame().robots[0].estimates;
    assert.equal(pose.x_m, estimate.x_m);
    assert.equal(pose.y_m, estimate.y_m);
    assert.match(await page.locator('#headline').textContent(), /^odometry 0\.\d+ m off, estimate 0\.00\d m off$/);
  });
});

test('an estimate that nobody renews is said to be old, and the robot to be silent', async () => {
  await withStation({}, async (page, station) => {
    station.advance(60);
    await page.waitForFunction((t_s) => Number(document.getElementById('pose').dataset.t_s) === t_s, station.now_s);
    assert.equal(await page.locator('#silence').isVisible(), false);
    const since_s = station.now_s;
    const now_s = since_s + 14;
    const truth = { ...station.frame().truth[0], t_s: now_s };
    station.send({ type: 'frame', now_s, truth: [truth], robots: [{ id: '0/1/1', scores: [{ t_s: now_s, estimate_m: null, odometry_m: 0.4, claim_m: null }] }] });
    await page.waitForFunction(() => document.getElementById('silence').textContent === 'robot silent for 14 s');
    assert.equal(await page.locator('#silence').isVisible(), true);
    assert.equal(await page.locator('#headline').textContent(), 'odometry 0.40 m off, estimate not known');
    const readings = await page.locator('#pose.stale dd').allTextContents();
    assert.ok(readings.includes('14.1 s') && readings.includes('14.0 s old'), readings.join(', '));
    station.now_s = now_s;
    station.advance(1);
    await page.waitForFunction(() => document.getElementById('silence').hidden && !document.querySelector('#pose.stale'));
  });
});

test('how many observations came is what the station has counted', async () => {
  await withStation({}, async (page, station) => {
    station.advance(100);
    await page.locator('#innovations').scrollIntoViewIfNeeded();
    await page.waitForFunction(() => document.querySelector('#innovations tbody td')?.textContent === '7 100');
  });
});

const THREE = { robots: ['0/1/1', '0/2/1', '1/1/1'], names: { '0/1/1': 'left', '0/2/1': 'right' } };

// Waits until the page shows this robot's last estimate.
function showing(page, id) {
  return page.waitForFunction((wanted) => document.getElementById('pose').dataset.robot === wanted, id);
}

test('one robot needs no list', async () => {
  await withStation({}, async (page, station) => {
    station.advance(10);
    await showing(page, '0/1/1');
    assert.equal(await page.locator('#robots').isVisible(), false);
  });
});

test('with several robots one is chosen by click or keys, and the page shows that one', async () => {
  await withStation(THREE, async (page, station) => {
    station.advance(60);
    await page.locator('#robots').waitFor({ state: 'visible' });
    await page.waitForFunction(() => document.querySelectorAll('#robots tbody tr').length === 3);
    assert.deepEqual(await page.locator('#robots tbody th').allTextContents(), ['left 0/1/1', 'right 0/2/1', '1/1/1 ']);
    await page.locator('#robots tbody tr').nth(1).locator('td').first().click();
    await showing(page, '0/2/1');
    // The list is drawn some frames after the pose: panels that do not move take turns.
    await page.waitForFunction(() => document.querySelector('#robots tr.chosen th')?.textContent === 'right 0/2/1');
    assert.equal(await page.getByRole('radio', { name: 'right' }).isChecked(), true);
    station.advance(1);
    const second = station.frame().robots[1].estimates[0];
    await page.waitForFunction((x_m) => Number(document.getElementById('pose').dataset.x_m) === x_m, second.x_m);
    assert.match(await page.locator('#headline').textContent(), /^right: odometry 0\.\d+ m off, estimate 0\.00\d m off$/);
    await page.getByRole('radio', { name: 'right' }).press('ArrowDown');
    await showing(page, '1/1/1');
    assert.equal(await page.locator('#error-title').textContent(), 'How far off of 1/1/1');
  });
});

test('the list says who is silent and who is lost, and a name is text', async () => {
  const markup = '<b>bold</b>';
  await withStation({ ...THREE, names: { '0/2/1': markup } }, async (page, station) => {
    station.advance(60);
    station.robots = ['0/1/1'];
    for (let batch = 0; batch < 5; batch += 1) station.advance(41);
    station.send({ type: 'frame', now_s: station.now_s, robots: [{ id: '1/1/1', lost_t_s: station.now_s }] });
    await seeing(page, '#robots', () => [...document.querySelectorAll('.robot-state')].map((cell) => cell.textContent).join() === 'live,silent for 4 s,lost for 4 s');
    assert.equal(await page.locator('.robot-name').nth(1).textContent(), markup);
    assert.equal(await page.locator('#robots b').count(), 0);
  });
});

test('a robot on the map is chosen by a click, and a drag chooses none', async () => {
  await withStation(THREE, async (page, station) => {
    station.advance(60);
    await page.locator('#robots').waitFor({ state: 'visible' });
    // The second one is brought to the middle of the map and left there while the first one is chosen again.
    await page.getByRole('radio', { name: 'right' }).check();
    await showing(page, '0/2/1');
    const map = page.locator('.map canvas');
    await map.press('f');
    await seeing(page, '#arena', () => new Promise((done) => { requestAnimationFrame(() => requestAnimationFrame(() => done(true))); }));
    await map.press('ArrowLeft');
    await map.press('ArrowRight');
    await page.getByRole('radio', { name: 'left' }).check();
    await showing(page, '0/1/1');
    const { x, y, width, height } = await map.boundingBox();
    await page.mouse.move(x + width / 2, y + height / 2);
    await page.waitForFunction(() => document.querySelector('.map canvas').title === 'right');
    await page.mouse.down();
    await page.mouse.move(x + width / 2 + 30, y + height / 2);
    await page.mouse.move(x + width / 2, y + height / 2, { steps: 3 });
    await page.mouse.move(x + width / 2 + 30, y + height / 2);
    await page.mouse.up();
    station.advance(1);
    await page.waitForFunction((t_s) => Number(document.getElementById('pose').dataset.t_s) === t_s, station.now_s);
    assert.equal((await poseOf(page)).robot, '0/1/1');
    await page.mouse.click(x + width / 2 + 30, y + height / 2);
    await showing(page, '0/2/1');
  });
});

test('commands are for the chosen robot, and who drives one does not drive on with another', async () => {
  await withStation(THREE, async (page, station) => {
    station.advance(10);
    await page.locator('#robots').waitFor({ state: 'visible' });
    await page.getByRole('radio', { name: 'right' }).check();
    await page.getByRole('button', { name: 'Camera off', exact: true }).click();
    assert.deepEqual(await lastOf(station, 1), { command: 'camera', on: false, robot: '0/2/1' });
    await seen(page, '#parameters', '#parameter-slip_nis');
    await page.getByRole('button', { name: 'Defaults' }).click();
    assert.deepEqual(await lastOf(station, 2), { command: 'default-parameters' });
    await page.getByRole('button', { name: 'Drive with the keys' }).click();
    await page.locator('#robots').getByRole('radio', { name: '1/1/1' }).check();
    assert.equal(await page.getByRole('button', { name: 'Drive with the keys' }).getAttribute('aria-pressed'), 'false');
  });
});

test('which sources are left out is told of each robot', async () => {
  await withStation(THREE, async (page, station) => {
    station.advance(10);
    station.send({ type: 'frame', now_s: station.now_s, switched_off: [], robots: [{ id: '0/1/1', switched_off: [] }, { id: '0/2/1', switched_off: [3] }] });
    await seen(page, '#innovations', '[aria-label="Use camera"]:checked');
    // The list is out of sight by now, and may not have been drawn before.
    await seen(page, '#robots', '#robots input[value="0/2/1"]');
    await page.getByRole('radio', { name: 'right' }).check();
    await seen(page, '#innovations', '[aria-label="Use camera"]:not(:checked)');
    await page.getByRole('radio', { name: 'left' }).check();
    await seen(page, '#innovations', '[aria-label="Use camera"]:checked');
  });
});

test('after a loss the page comes back by itself and begins anew', async () => {
  await withStation({ forgives: ['WebSocket connection', 'ERR_CONNECTION_REFUSED'] }, async (page, station) => {
    station.advance(50);
    await page.waitForFunction(() => Number(document.getElementById('pose').dataset.t_s) > 0.9);
    await page.evaluate(() => { globalThis.isSamePage = true; });
    await station.close();
    await waitForState(page, 'lost');
    station.now_s = 0;
    await station.open();
    await waitForState(page, 'live');
    station.advance(5);
    await page.waitForFunction((t_s) => Number(document.getElementById('pose').dataset.t_s) === t_s, station.now_s);
    assert.equal(await page.evaluate(() => globalThis.isSamePage), true, 'without loading it anew');
  });
});

test('markup in texts is shown and not run', async () => {
  const markup = '<img src=x onerror="globalThis.wasRun = true"><b>bold</b>';
  await withStation({ robots: ['0/1/1', markup] }, async (page, station) => {
    const frame = station.frame();
    frame.log = [{ t_s: 1, severity: markup, text: markup }];
    frame.links = [{ id: markup, name: markup, state: markup }];
    frame.clock = { method: markup };
    frame.recording = { name: markup, bytes: 1 };
    frame.robots[0].fusion = [{ t_s: 1, sensor: markup, kind: markup, verdict: markup, lag_s: 0, nis: 1, dof: 1, innovation: [1], sigma: [1] }];
    frame.robots[0].calibration = [{ name: markup, value: 1, sigma: 1, unit: markup }];
    station.send(frame);
    for (const panel of ['#log .text', '#links h3', '#recording-state', '#innovations tbody th', '#calibration tbody th']) {
      const part = panel.split(' ')[0];
      await seeing(page, part, (selector) => document.querySelector(selector)?.textContent.includes('<img'), panel).catch(() => assert.fail(`${panel} shows the text`));
    }
    assert.equal(await page.locator('#panels b, #panels td img, #panels th img, #panels p img').count(), 0);
    assert.equal(await page.evaluate(() => globalThis.wasRun), undefined);
  });
});

test('nonsense on the stream leaves the page alive', async () => {
  await withStation({}, async (page, station) => {
    station.advance(10);
    const nonsense = [
      '', 'null', '3', '"text"', '[]', '{', '{"type":"frame"}', '{"type":"frame","robots":null,"truth":3,"log":{},"links":[null,1],"parameters":[null]}', '{"type":"unheard"}',
      { type: 'frame', now_s: null, robots: [{ id: '0/1/1', estimates: [{ t_s: 0.3, x_m: null, y_m: 'east', heading_rad: 1e308, major_m: -1 }, { t_s: 1e300 }], fixes: [{ t_s: 0.3 }], fusion: [{ t_s: 0.3, sensor: 'camera', dof: 99, nis: -1, innovation: [null], sigma: 'wide' }] }] },
      { type: 'frame', now_s: 0.4, log: [{ t_s: 0.4, severity: 'info', text: 'long '.repeat(100_000) }] },
      { type: 'frame', now_s: 0.5, robots: Array.from({ length: 300 }, (_, index) => ({ id: `robot ${index}`, estimates: [{ t_s: 0.5, x_m: index, y_m: 0, heading_rad: 0 }] })) },
    ];
    for (const message of nonsense) station.send(message);
    await page.waitForFunction(() => document.querySelectorAll('#robots tbody tr').length > 10);
    assert.ok((await page.locator('#robots tbody tr').count()) <= 64);
    await seeing(page, '#log', () => document.querySelector('#log .text')?.textContent.startsWith('long '));
    assert.ok((await page.locator('#log .text').first().textContent()).length <= 400);
    await waitForState(page, 'live');
  });
});

test('sliders and fields send the parameter that they stand for, and show what the station says', async () => {
  await withStation({}, async (page, station) => {
    const row = page.locator('.parameter[data-name="slip_nis"]');
    await seen(page, '#parameters', '#parameter-slip_nis');
    await row.locator('input[type=number]').fill('20');
    await row.locator('input[type=number]').press('Enter');
    await row.locator('input[type=range]').focus();
    await row.locator('input[type=range]').press('End');
    await lastOf(station, 2);
    assert.deepEqual(station.commands, [{ command: 'set-parameter', name: 'slip_nis', value: 20 }, { command: 'set-parameter', name: 'slip_nis', value: 100 }]);
    await row.locator('input[type=range]').blur();
    station.send({ type: 'frame', now_s: 1, parameters: [{ name: 'slip_nis', value: 42.5 }] });
    await seeing(page, '#parameter-slip_nis', () => document.getElementById('parameter-slip_nis').value === '42.5');
    await row.locator('button').click();
    assert.deepEqual(await lastOf(station, 3), { command: 'set-parameter', name: 'slip_nis', value: 10.83 });
  });
});

test('every fault of the simulated brick is one command', async () => {
  await withStation({}, async (page, station) => {
    const press = async (name, expected) => {
      const count = station.commands.length;
      await page.getByRole('button', { name, exact: true }).click();
      const command = await lastOf(station, count + 1);
      for (const [key, value] of Object.entries(command)) if (typeof value === 'number') command[key] = Number(value.toFixed(6));
      assert.deepEqual(command, expected);
    };
    await press('Kidnap', { command: 'kidnap', forward_m: 0.3, left_m: 0.2, turn_rad: 1.047198 });
    await press('Slip', { command: 'slip', wheel: 'left', factor: 0.8, seconds: 1 });
    await press('Camera off', { command: 'camera', on: false });
    await press('Camera on', { command: 'camera', on: true });
    await press('Camera late', { command: 'camera-delay', delay_ms: 300 });
    await press('Gyro bias step', { command: 'gyro-bias-step', rad_per_s: 0.05236 });
    await press('Link', { command: 'link-profile', profile: null });
    await press('Pull the cable', { command: 'pull-cable', seconds: 3 });
    await press('Back to the path', { command: 'path' });
    const count = station.commands.length;
    await page.getByLabel('odometry', { exact: true }).check();
    assert.deepEqual(await lastOf(station, count + 1), { command: 'steering', by: 'odometry' });
  });
});

test('what is switched and set shows what the station says, after a reload and when others change it', async () => {
  await withStation({}, async (page, station) => {
    station.switchedOff = [3];
    station.simulator = { steering: 'odometry', link_profile: 'bluetooth-spp' };
    await page.reload();
    await waitForState(page, 'live');
    station.advance(5);
    await seeing(page, '#innovations', () => document.querySelector('[aria-label="Use camera"]')?.checked === false);
    assert.equal(await page.getByLabel('Use wheels').isChecked(), true);
    const profile = page.getByLabel('as bad as');
    await seeing(page, '#simulator', () => [...document.querySelectorAll('#simulator select')].some((select) => select.value === 'bluetooth-spp'));
    assert.equal(await profile.inputValue(), 'bluetooth-spp');
    assert.equal(await page.getByLabel('odometry', { exact: true }).isChecked(), true);
    // A choice that was not yet asked for is not taken back by what is told once a second.
    await profile.selectOption('usb');
    station.advance(100);
    await seeing(page, '#pose', (t_s) => Number(document.getElementById('pose').dataset.t_s) === t_s, station.now_s);
    assert.equal(await profile.inputValue(), 'usb');
    station.send({ type: 'frame', now_s: station.now_s, switched_off: [0], simulator: { steering: 'estimate', link_profile: null } });
    await seeing(page, '#simulator', () => document.querySelector('input[name="steering"][value="estimate"]').checked);
    assert.equal(await profile.inputValue(), '');
    await seeing(page, '#innovations', () => document.querySelector('[aria-label="Use camera"]').checked && !document.querySelector('[aria-label="Use wheels"]').checked);
  });
});

test('filters are compared by a checkbox, and each has a row and a line of its own', async () => {
  await withStation({}, async (page, station) => {
    const box = page.getByLabel('Run further filters beside the one that sends');
    assert.equal(await box.isChecked(), false);
    await box.check();
    assert.deepEqual(await lastOf(station, 1), { command: 'compare-filters', on: true });
    const row = { error_m: 0.01, error_rms_m: 0.02, apart_m: 0, major_m: 0.03, nis: 1, used: 9, gated: 0 };
    const comparison = ['', 'ekf5', 'odometry'].map((filter, index) => ({ ...row, filter, apart_m: index / 10 }));
    const compared = ['odometry', 'ekf5'].map((filter) => ({ t_s: station.now_s, filter, x_m: 0, y_m: 0 }));
    station.send({ type: 'frame', now_s: station.now_s, is_comparing: true, robots: [{ id: '0/1/1', compared, comparison }] });
    await seeing(page, '#comparison', () => document.querySelectorAll('#comparison tbody tr').length === 3);
    const names = await page.locator('#comparison tbody th').allTextContents();
    assert.deepEqual(names, ['sent', 'ekf5', 'odometry']);
    assert.equal(await page.locator('#comparison tbody tr').nth(2).locator('td').nth(2).textContent(), '200 mm');
    const lines = await page.locator('#comparison .key').evaluateAll((keys) => keys.map((key) => getComputedStyle(key, '::before').borderTopColor));
    assert.equal(new Set(lines).size, 3);
    station.send({ type: 'frame', now_s: station.now_s, is_comparing: false, robots: [] });
    await seeing(page, '#comparison', () => !document.querySelector('#comparison input').checked);
  });
});

test('a source that is heard later can be switched as well', async () => {
  await withStation({}, async (page, station) => {
    const heard = station.sources;
    station.sources = [];
    await page.reload();
    await waitForState(page, 'live');
    station.sources = heard;
    station.advance(5);
    await seen(page, '#innovations', '[aria-label="Use camera"]:enabled');
    await page.getByLabel('Use camera').uncheck();
    assert.deepEqual(await lastOf(station, 1), { command: 'switch-source', sensor: 3, on: false, robot: '0/1/1' });
    // What is told once a second may be older than the click: it is no news and moves nothing. A refusal takes the click back.
    station.advance(100);
    await seeing(page, '#pose', (t_s) => Number(document.getElementById('pose').dataset.t_s) === t_s, station.now_s);
    await seeing(page, '#innovations', () => document.querySelector('[aria-label="Use camera"]').checked === false);
  });
});

test('keys drive only while armed, and letting go stops the robot', async () => {
  await withStation({}, async (page, station) => {
    await page.locator('body').press('w');
    await page.getByRole('button', { name: 'Drive with the keys' }).click();
    await page.keyboard.down('w');
    assert.deepEqual(await lastOf(station, 1), { command: 'drive', forward_m_per_s: 0.2, turn_rad_per_s: 0 });
    await lastOf(station, 3);
    await page.keyboard.up('w');
    await page.keyboard.press('Escape');
    const stop = { command: 'drive', forward_m_per_s: 0, turn_rad_per_s: 0 };
    await station.until((commands) => JSON.stringify(commands.at(-1)) === JSON.stringify(stop));
    assert.equal(await page.getByRole('button', { name: 'Drive with the keys' }).getAttribute('aria-pressed'), 'false');
  });
});

test('what the station refuses is said on the page', async () => {
  await withStation({ forgives: ['status of 400'] }, async (page, station) => {
    station.refusal = 'forward_m is 900, must lie in -100 to 100';
    await page.getByRole('button', { name: 'Kidnap', exact: true }).click();
    await page.waitForFunction((text) => document.querySelector('#announcer.error')?.textContent === text, station.refusal);
  });
});

test('a page that may only look sends no command and says why, until it may', async () => {
  await withStation({}, async (page, station) => {
    station.canCommand = false;
    await page.reload();
    await waitForState(page, 'live');
    assert.equal(await page.locator('#simulator .body').evaluate((body) => body.inert), true);
    await page.getByRole('button', { name: 'Begin anew' }).click();
    await page.waitForFunction(() => document.querySelector('#announcer.error')?.textContent.startsWith('Your token only lets you look'));
    assert.deepEqual(station.commands, []);
    station.canCommand = true;
    await page.reload();
    await waitForState(page, 'live');
    await page.getByRole('button', { name: 'Kidnap', exact: true }).click();
    await lastOf(station, 1);
  });
});

test('a recording is looked at with a scrubber and left again', async () => {
  await withStation({}, async (page, station) => {
    const made = new FakeStation();
    const frames = Array.from({ length: 500 }, () => {
      made.now_s += 0.02;
      return made.frame();
    });
    station.replay = { now_s: 10, robots: [{ id: '0/1/1', estimates: frames.map((frame) => frame.robots[0].estimates[0]) }], truth: frames.map((frame) => frame.truth[0]), log: [3, 4.5, 7, 9].map((t_s) => ({ t_s, severity: 6, text: `at ${t_s} s` })) };
    station.advance(5);
    await page.getByRole('button', { name: 'Drive with the keys' }).click();
    await seen(page, '#recordings', '[aria-label="Replay square-1.mcap"]');
    await page.getByRole('button', { name: 'Replay square-1.mcap' }).click();
    await page.getByRole('button', { name: 'Pause' }).click();
    const scrubber = page.getByLabel('Time in the recording');
    await scrubber.fill('5');
    await seeing(page, '#pose', () => Math.abs(Number(document.getElementById('pose').dataset.t_s) - 5) < 0.03);
    const shown = await poseOf(page);
    assert.equal(shown.x_m, frames[Math.round(shown.t_s / 0.02) - 1].robots[0].estimates[0].x_m);
    // Events up to that time, and nothing that moves the live robot.
    await page.locator('#log').scrollIntoViewIfNeeded();
    await page.waitForFunction(() => [...document.querySelectorAll('#log .text')].map((line) => line.textContent).join() === 'at 4.5 s,at 3 s');
    await page.locator('#simulator .note').first().waitFor({ state: 'visible' });
    assert.equal(await page.evaluate(() => document.querySelector('#simulator .body').inert && document.querySelector('#parameters .body').inert), true);
    await page.keyboard.press('w');
    assert.equal(station.commands.length, 0);
    await scrubber.press('ArrowRight');
    await seeing(page, '#pose', () => Math.abs(Number(document.getElementById('pose').dataset.t_s) - 5.2) < 0.03);
    await page.getByRole('button', { name: 'Back to live' }).click();
    assert.equal(await page.evaluate(() => document.querySelector('#simulator .body').inert), false);
    await seeing(page, '#pose', (t_s) => Number(document.getElementById('pose').dataset.t_s) === t_s, station.now_s);
  });
});

test('the robots of a recording are chosen as those of the live session, and are as at its time', async () => {
  await withStation({}, async (page, station) => {
    const made = new FakeStation({ robots: ['0/1/1', '0/2/1'] });
    const frames = Array.from({ length: 500 }, () => {
      made.now_s += 0.02;
      return made.frame();
    });
    const estimates = (index, end) => frames.slice(0, end).map((frame) => frame.robots[index].estimates[0]);
    station.replay = { now_s: 10, truth: frames.flatMap((frame) => frame.truth), robots: [{ id: '0/1/1', estimates: estimates(0, 500) }, { id: '0/2/1', name: 'right', estimates: estimates(1, 200), lost_t_s: 9 }] };
    station.advance(5);
    await seen(page, '#recordings', '[aria-label="Replay square-1.mcap"]');
    await page.getByRole('button', { name: 'Replay square-1.mcap' }).click();
    await page.getByRole('button', { name: 'Pause' }).click();
    const scrubber = page.getByLabel('Time in the recording');
    const states = (wanted) => seeing(page, '#robots', (text) => [...document.querySelectorAll('.robot-state')].map((cell) => cell.textContent).join() === text, wanted);
    await scrubber.fill('3');
    await states('heard,heard');
    await page.getByRole('radio', { name: 'right' }).check();
    await showing(page, '0/2/1');
    await scrubber.fill('6.5');
    await states('heard,silent for 2 s');
    await scrubber.fill('9.5');
    await states('heard,lost for 5 s');
    assert.equal(station.commands.length, 0);
    await page.getByRole('button', { name: 'Back to live' }).click();
    await showing(page, '0/1/1');
    assert.equal(await page.locator('#robots').isVisible(), false);
  });
});

test('a recording that is begun later stands in the list by itself', async () => {
  await withStation({}, async (page, station) => {
    const whole = station.recordings;
    station.recordings = [];
    await page.reload();
    await waitForState(page, 'live');
    station.advance(50);
    await seeing(page, '#recordings', () => document.getElementById('recording-state').textContent.startsWith('Recording now.mcap'));
    assert.equal(await page.getByRole('button', { name: 'Replay now.mcap' }).count(), 0);
    station.recordings = whole;
    station.advance(50);
    await seen(page, '#recordings', '[aria-label="Replay now.mcap"]');
  });
});

test('the map is moved with keys and shows its legend', async () => {
  await withStation({}, async (page, station) => {
    station.advance(20);
    const map = page.locator('.map canvas');
    await map.focus();
    await map.press('+');
    assert.equal(await page.getByRole('button', { name: 'Fit' }).getAttribute('aria-pressed'), 'false');
    await map.press('f');
    assert.equal(await page.getByRole('button', { name: 'Follow' }).getAttribute('aria-pressed'), 'true');
    await map.press('0');
    assert.equal(await page.getByRole('button', { name: 'Fit' }).getAttribute('aria-pressed'), 'true');
    assert.equal(await page.locator('.legend li:visible').count(), 8);
  });
});

test('the choice of colours is remembered', async () => {
  await withStation({}, async (page) => {
    await page.emulateMedia({ colorScheme: 'light' });
    await page.getByRole('button', { name: 'Change to dark colours' }).click();
    await page.reload();
    await waitForState(page, 'live');
    assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), 'dark');
    await page.getByRole('button', { name: 'Change to light colours' }).click();
    assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), 'light');
  });
});
