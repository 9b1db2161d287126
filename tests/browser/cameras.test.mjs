// The pictures of a camera on the page, with the tags that the station found in them: the simulated brick's camera renders them.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { Program, newFolder } from './support/station.mjs';

let browser;
let station;

before(async () => {
  browser = await Browser.launch();
  station = Program.start(['run', '--link', 'sim://square', '--camera', 'sim', '--dashboard', '127.0.0.1:0', '--no-record'], await newFolder());
});

after(async () => {
  await browser?.close();
  await station?.remove();
});

test('the picture is shown a few times a second, with its tags drawn on it', async () => {
  const page = await browser.open(await station.address());
  await page.waitForSelector('#cameras polygon');
  await page.evaluate(() => document.getElementById('cameras').scrollIntoView());
  const first = await page.$eval('#cameras img', (image) => ({ src: image.src, width: image.naturalWidth, height: image.naturalHeight }));
  assert.deepEqual([first.width, first.height], [640, 480]);
  // Floor and robot: all tags are seen when the whole picture is searched.
  await page.waitForFunction(() => [...document.querySelectorAll('#cameras text')].some((text) => text.textContent === '580'));
  await page.waitForFunction(() => [...document.querySelectorAll('#cameras text')].some((text) => text.textContent === '0'));
  await page.waitForFunction((src) => document.querySelector('#cameras img').src !== src, first.src);
  // The robot's tag lies where the map has the robot: near the lower left floor tag at the start, and inside the picture always.
  const inside = await page.$$eval('#cameras polygon', (outlines) => outlines.every((outline) =>
    [...outline.points].every(({ x, y }) => x > 0 && x < 640 && y > 0 && y < 480)));
  assert.equal(inside, true);
  const state = await page.$eval('#cameras .figure', (line) => line.textContent);
  assert.match(state, /^640 x 480, \d+\.\d pictures\/s, searched after \d+ ms, \d+ dropped, 0 damaged$/);
  if (process.env.CAMERA_SCREENSHOT) await (await page.$('#cameras')).screenshot({ path: process.env.CAMERA_SCREENSHOT });
});

test('a camera that nobody has calibrated shows the steps to it, and where in the picture the robot has been', async () => {
  const brick = Program.start(['sim', 'square', '--listen', 'tcp://127.0.0.1:0', '--pictures-listen', '127.0.0.1:0'], await newFolder());
  const [, link] = await brick.finds(/listening on (127\.0\.0\.1:\d+)/);
  const [source] = await brick.finds(/http:\/\/127\.0\.0\.1:\d+\//);
  const uncalibrated = Program.start(
    ['run', '--link', `tcp://${link}`, '--camera', source, '--dashboard', '127.0.0.1:0', '--no-record'], await newFolder());
  try {
    const page = await browser.open(await uncalibrated.address());
    await page.waitForSelector('#cameras .steps');
    await page.evaluate(() => document.getElementById('cameras').scrollIntoView());
    const done = (count) => page.waitForFunction((least) => document.querySelectorAll('#cameras .steps .done').length >= least, count);
    await done(2);
    const steps = await page.$$eval('#cameras .steps li', (items) => items.map((item) => item.textContent));
    assert.equal(steps.length, 4);
    assert.match(steps[0], /4 of 4 tags seen$/);
    assert.match(steps[3], /posebridge camera calibrate --drive/);
    await page.waitForFunction(() => document.querySelectorAll('#cameras rect').length >= 2);
    if (process.env.CAMERA_SCREENSHOT) await (await page.$('#cameras')).screenshot({ path: `${process.env.CAMERA_SCREENSHOT}.steps.png` });
    await page.close();
  } finally {
    await uncalibrated.remove();
    await brick.remove();
  }
});
