// The pictures of the README: the real page half a minute into a drive, after a kidnap. They are looked at with every run, and kept in
// docs/images/ only with BROWSER_SCREENSHOTS=1.

import assert from 'node:assert/strict';
import { writeFile } from 'node:fs/promises';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { waitForState } from './support/page.mjs';
import { Program, newFolder } from './support/station.mjs';
import { Tap } from './support/tap.mjs';

const IS_KEPT = process.env.BROWSER_SCREENSHOTS === '1';
// A lap of the square takes half a minute; to see that pictures come out a few seconds will do.
const KIDNAP_AT_S = IS_KEPT ? 22 : 3;
const LOOK_FOR_S = IS_KEPT ? 9 : 2;
const LARGEST_BYTES = 200_000;

const SHOTS = [
  { name: 'dashboard-light', width: 1280, height: 960, colorScheme: 'light' },
  { name: 'dashboard-dark', width: 1280, height: 960, colorScheme: 'dark' },
  { name: 'dashboard-phone', width: 390, height: 844, colorScheme: 'light' },
];

let station;
let browser;

before(async () => {
  station = Program.start(['run', '--out', 'session', '--dashboard', '127.0.0.1:0'], await newFolder());
  browser = await Browser.launch();
});

after(async () => {
  await browser?.close();
  await station?.remove();
});

test('pictures of the page in light and dark colours and on a phone', async (context) => {
  const tap = new Tap();
  const page = await browser.open(await station.address(), { tap });
  await waitForState(page, 'live');
  await tap.pass(KIDNAP_AT_S);
  await page.getByRole('button', { name: 'Kidnap', exact: true }).click();
  await tap.pass(LOOK_FOR_S);
  for (const { name, width, height, colorScheme } of SHOTS) {
    await page.emulateMedia({ colorScheme });
    await page.setViewportSize({ width, height });
    await page.evaluate(() => scrollTo(0, 0));
    await page.waitForFunction((theme) => document.documentElement.dataset.theme === theme, colorScheme);
    await page.waitForFunction(() => document.querySelectorAll('#error canvas').length > 0);
    // Every panel in sight was drawn in the new size once the station has spoken for a while.
    await tap.pass(0.5);
    const picture = await page.screenshot();
    context.diagnostic(`${name}: ${(picture.length / 1000).toFixed(0)} kB`);
    assert.ok(picture.length > 20_000 && picture.length < LARGEST_BYTES, `${name} has ${picture.length} bytes`);
    if (IS_KEPT) await writeFile(path.join(process.env.BROWSER_ROOT, 'docs/images', `${name}.png`), picture);
  }
});
