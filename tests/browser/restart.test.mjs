// The station ends and begins again at the same address: the page is back without being loaded anew, and shows the new session.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { poseOf, waitForState } from './support/page.mjs';
import { Program, newFolder } from './support/station.mjs';

const programs = [];
let browser;

before(async () => {
  browser = await Browser.launch();
});

after(async () => {
  await browser?.close();
  for (const program of programs) await program.remove();
});

async function start(address) {
  const program = Program.start(['run', '--dashboard', address], await newFolder());
  programs.push(program);
  return program.address();
}

test('after a restart of the station the page is back by itself', async () => {
  const address = await start('127.0.0.1:0');
  const page = await browser.open(address, { forgives: ['ERR_CONNECTION_REFUSED'] });
  await page.waitForFunction(() => Number(document.getElementById('pose').dataset.t_s) > 2);
  await page.evaluate(() => { globalThis.isSamePage = true; });
  const before = await poseOf(page);
  assert.equal(await programs[0].stop(), 0, programs[0].text);
  await waitForState(page, 'lost');
  assert.equal(await start(new URL(address).host), address);
  await waitForState(page, 'live');
  await page.waitForFunction((last_s) => Number(document.getElementById('pose').dataset.t_s) < last_s, before.t_s);
  assert.equal(await page.evaluate(() => globalThis.isSamePage), true);
});
