// The page's memory over ten minutes at 50 estimates a second, in the made-up station's time: as fast as the page takes it.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { FakeStation } from './support/fake_station.mjs';
import { heldBytes } from './support/measure.mjs';
import { waitForState } from './support/page.mjs';

const FRAMES_PER_S = 50;
const BATCH = 250;
// The map's tracks are full after 82 s, the log of 300 lines after 300 s, the tracks of learned numbers after 307 s; from then on nothing
// may be kept that was not kept before.
const FILL_S = 320;
const TEN_MINUTES_S = 600;
// The smallest object that each of the frames could leave behind has 16 bytes. Less than that is the engine's own: what it knows of types.
// Code is not counted: the engine compiles it again when it likes, and that alone has been more than this.
const MOST_GROWTH_BYTES = 16 * FRAMES_PER_S * TEN_MINUTES_S;

let browser;
let station;

before(async () => {
  station = new FakeStation();
  await station.open();
  browser = await Browser.launch();
});

after(async () => {
  await browser.close();
  await station.close();
});

test('memory is flat over ten minutes', async (context) => {
  const page = await browser.open(station.address);
  await waitForState(page, 'live');
  await run(page, station, FILL_S);
  const full = await heldBytes(page);
  await run(page, station, TEN_MINUTES_S);
  const later = await heldBytes(page);
  context.diagnostic(`holds ${(full / 1e6).toFixed(3)} MB when the tracks are full, ${(later / 1e6).toFixed(3)} MB ten minutes later`);
  assert.ok(later - full < MOST_GROWTH_BYTES, `${later - full} bytes more`);
});

// Sends in batches and waits for each to be on the page, so that nothing piles up in between.
async function run(page, station, seconds) {
  for (let sent = 0; sent < seconds * FRAMES_PER_S; sent += BATCH) {
    station.advance(BATCH);
    await page.waitForFunction((t_s) => Number(document.getElementById('pose').dataset.t_s) === t_s, station.now_s);
  }
}
