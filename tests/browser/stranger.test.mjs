// A stranger's path: start the program, open what it says, kidnap the robot, see it recover, stop, open the report. No flag, no manual: every
// step follows from what program and page show.

import assert from 'node:assert/strict';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { pathToFileURL } from 'node:url';
import { Browser } from './support/browser.mjs';
import { waitForState } from './support/page.mjs';
import { Program, newFolder, run } from './support/station.mjs';
import { Tap, fixesOf } from './support/tap.mjs';

let station;
let browser;

before(async () => {
  browser = await Browser.launch();
});

after(async () => {
  await browser?.close();
  await station?.remove();
});

test('a stranger starts the program, kidnaps the robot, sees it recover, and opens the report', async (context) => {
  // "cargo run": no argument at all.
  station = Program.start([], await newFolder());
  const address = await station.address();
  context.diagnostic(`it says: ${station.said.split('\n').find((line) => line.includes(address))}`);
  await station.finds(/odometry [\d.]+ m off, estimate [\d.]+ m off/);

  const tap = new Tap();
  const page = await browser.open(address, { tap, forgives: ['ERR_CONNECTION_REFUSED'] });
  await waitForState(page, 'live');
  await page.waitForFunction(() => /^odometry .* off, estimate .* off$/.test(document.getElementById('headline').textContent));
  await tap.until('fixes', (frame) => fixesOf(frame).some((fix) => fix.verdict === 'accepted'));

  const resets = await page.evaluate(() => Number(document.getElementById('pose').dataset.reset_counter));
  await page.getByRole('button', { name: 'Kidnap', exact: true }).click();
  await page.waitForFunction((before) => Number(document.getElementById('pose').dataset.reset_counter) > before, resets);
  await page.waitForFunction(() => /estimate 0\.0[0-4]\d m off$/.test(document.getElementById('headline').textContent));
  context.diagnostic(`the page says: ${await page.locator('#headline').textContent()}`);

  assert.equal(await station.stop(), 0, station.text);
  await waitForState(page, 'lost');
  const [, recording] = await station.finds(/posebridge report (\S+)/);
  const said = await run(['report', recording], station.folder);
  const [, report] = /page: (\S+)/.exec(said);
  const shown = await browser.open(pathToFileURL(path.resolve(station.folder, report)).href);
  assert.ok((await shown.locator('svg, img').count()) > 3, 'the report has its pictures');
  assert.match(await shown.locator('body').textContent(), /estimate/);
});
