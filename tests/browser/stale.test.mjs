// What is old is shown as old, with its age, and nothing of it says now or live: a robot, a link, the station, a recording at the time that is shown.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { FakeStation } from './support/fake_station.mjs';
import { seeing, waitForState } from './support/page.mjs';

let browser;

before(async () => {
  browser = await Browser.launch();
});

after(() => browser.close());

async function withStation(options, use) {
  const station = new FakeStation({ robots: ['0/1/1', '0/2/1'], ...options });
  await station.open();
  const page = await browser.open(station.address, options);
  await page.setViewportSize({ width: 1440, height: 2400 });
  try {
    await waitForState(page, 'live');
    station.advance(100);
    station.send({ type: 'frame', now_s: station.now_s, robots: [quantities(station.now_s)] });
    await page.waitForFunction(() => document.querySelectorAll('#links .card').length > 0 && document.querySelectorAll('.robot-state').length === 2 && document.querySelector('#thermometers td.state'));
    await page.waitForFunction(() => document.querySelectorAll('#calibration tbody tr').length === 2);
    await use(page, station);
  } finally {
    await page.close();
    await station.close();
  }
}

function quantities(t_s) {
  return { id: '0/1/1', quantities: [{ t_s, name: 'water', kind: 'temperature', unit: '°C', reading: 20, verdict: 'accepted', estimate: 21, bound_95: 1, rate_per_s: null, steps: 9, predicted: 0 }] };
}

// The parts of the page that say an age, and whether they do.
function ages(page) {
  return page.evaluate(() => {
    const says = (selector, pattern) => pattern.test(document.querySelector(selector)?.textContent ?? '');
    return {
      headline: says('#silence', /^robot silent for \d+ s$/) && !document.getElementById('silence').hidden,
      robots: [...document.querySelectorAll('.robot-state')].every((cell) => /^silent for \d+ s$/.test(cell.textContent)),
      numbers: says('#pose.stale', / s old$/),
      innovations: says('#innovations.stale h2', / s old$/),
      calibration: says('#calibration.stale h2', / s old$/),
      thermometers: says('#thermometers tr[data-state="silent"] td.state', /^silent for \d+ s$/),
    };
  });
}

// Words of the present anywhere on the page; events and names of files are those of their time.
function presentWords(page) {
  return page.evaluate(() => {
    const found = [];
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (walker.nextNode()) {
      const { parentElement, textContent } = walker.currentNode;
      const isShown = parentElement.getClientRects().length > 0 && !parentElement.closest('#log, #recordings, .unseen, script');
      if (isShown && /\b(now|live|connected|up)\b/i.test(textContent)) found.push(textContent);
    }
    return found;
  });
}

const allOld = (page) => seeing(page, '#arena', () => /\d s old/.test(document.querySelector('#innovations.stale h2')?.textContent ?? '') && document.querySelector('#pose.stale') && [...document.querySelectorAll('.robot-state')].every((cell) => cell.textContent.startsWith('silent')));

test('robots that fall silent are old, their links are not', async () => {
  await withStation({}, async (page, station) => {
    assert.equal(Object.values(await ages(page)).some(Boolean), false, 'nothing is old yet');
    const colour = () => page.evaluate(() => getComputedStyle(document.querySelector('#pose dd')).color);
    const fresh = await colour();
    station.robots = [];
    for (let second = 0; second < 6; second += 1) station.advance(50);
    await allOld(page);
    await page.waitForFunction(() => document.querySelector('#thermometers tr[data-state="silent"]'));
    assert.deepEqual(Object.entries(await ages(page)).filter(([, isOld]) => !isOld), []);
    assert.notEqual(await colour(), fresh, 'the numbers are grey');
    assert.equal(await page.locator('#connection').textContent(), 'connected');
    assert.equal(await page.locator('#links .card .state').first().textContent(), 'up');
    station.robots = ['0/1/1', '0/2/1'];
    station.advance(50);
    await seeing(page, '#arena', () => !document.querySelector('.panel.stale, #pose.stale'));
  });
});

test('when the station says nothing everything becomes old', async () => {
  await withStation({}, async (page, station) => {
    station.isSilent = true;
    await allOld(page);
    await page.waitForFunction(() => / s ago$/.test(document.querySelector('#links .card.stale .state')?.textContent ?? ''));
    await page.waitForFunction(() => document.querySelector('#thermometers tr[data-state="silent"]') && document.querySelector('#recording-state.stale'));
    assert.deepEqual(Object.entries(await ages(page)).filter(([, isOld]) => !isOld), []);
    assert.equal(await page.locator('#connection').textContent(), 'the station says nothing');
    assert.match(await page.locator('#connection-age').textContent(), /^last heard \d+ s ago$/);
    assert.match(await page.locator('#recording-state').textContent(), /^\d\.\d s ago: Recording now\.mcap/);
    assert.deepEqual((await presentWords(page)).filter((text) => !/^up \d/.test(text)), []);
    station.isSilent = false;
    station.advance(1);
    await waitForState(page, 'live');
    assert.equal(await page.locator('#connection-age').textContent(), '');
  });
});

test('a lost connection is said with its age, and what stands on the page ages', async () => {
  await withStation({ forgives: ['WebSocket connection', 'ERR_CONNECTION_REFUSED'] }, async (page, station) => {
    await station.close();
    await waitForState(page, 'lost');
    await allOld(page);
    assert.match(await page.locator('#connection-age').textContent(), /^last heard \d+ s ago$/);
    await page.waitForFunction(() => document.querySelectorAll('#links .card.stale').length === 2);
    assert.deepEqual((await presentWords(page)).filter((text) => !/^up \d/.test(text)), []);
    await station.open();
    await waitForState(page, 'live');
  });
});

test('in a paused replay ages are those of the time that is shown', async () => {
  await withStation({}, async (page, station) => {
    const made = new FakeStation();
    const frames = Array.from({ length: 500 }, () => {
      made.now_s += 0.02;
      return made.frame();
    });
    const estimates = frames.slice(0, 200).map((frame) => frame.robots[0].estimates[0]);
    station.replay = { now_s: 10, truth: frames.map((frame) => frame.truth[0]), robots: [{ id: '0/1/1', estimates }] };
    await page.getByRole('button', { name: 'Replay square-1.mcap' }).click();
    await page.getByRole('button', { name: 'Pause' }).click();
    const scrubber = page.getByLabel('Time in the recording');
    const age = (text) => seeing(page, '#pose', (wanted) => [...document.querySelectorAll('#pose dd')].at(-1).textContent === wanted, text);
    await scrubber.fill('6.5');
    await age('2.5 s old');
    await scrubber.fill('3');
    await age('of this time');
    // However long somebody looks, and whether or not the station is heard.
    station.isSilent = true;
    await page.waitForFunction(() => document.getElementById('connection').dataset.state === 'stalled');
    await age('of this time');
    assert.equal(await page.locator('#silence').isVisible(), false);
    await scrubber.fill('6.5');
    await age('2.5 s old');
    assert.deepEqual((await presentWords(page)).filter((text) => !/Back to live|go back to live/.test(text)), []);
  });
});
