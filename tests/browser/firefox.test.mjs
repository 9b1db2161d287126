// The page in Firefox: the essentials, on the made-up station.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { FakeStation } from './support/fake_station.mjs';
import { Firefox } from './support/firefox.mjs';

let firefox;
let station;

before(async () => {
  station = new FakeStation();
  await station.open();
  firefox = await Firefox.launch();
});

after(async () => {
  await firefox?.close();
  await station.close();
});

test('Firefox shows the estimate, draws map and charts, and sends commands', async () => {
  await firefox.open(station.address);
  await firefox.until("document.getElementById('connection').dataset.state === 'live'");
  station.advance(200);
  await firefox.until(`Number(document.getElementById('pose').dataset.t_s) === ${station.now_s}`);
  const [estimate] = station.frame().robots[0].estimates;
  assert.equal(await firefox.evaluate("Number(document.getElementById('pose').dataset.x_m)"), estimate.x_m);
  for (const panel of ['#arena .map', '#error', '#innovations']) {
    await firefox.evaluate(`document.querySelector('${panel}').scrollIntoView()`);
    station.advance(1);
    await firefox.until(`(${isDrawn})('${panel} canvas')`);
  }
  // The panel of the simulated brick is drawn in its turn, once it is in sight.
  await firefox.evaluate("document.getElementById('simulator').scrollIntoView()");
  await firefox.until("[...document.querySelectorAll('button')].some((button) => button.textContent === 'Camera off')");
  await firefox.evaluate("[...document.querySelectorAll('button')].find((button) => button.textContent === 'Camera off').click()");
  await firefox.until("document.getElementById('announcer').textContent.includes('camera')");
  assert.deepEqual(station.commands, [{ command: 'camera', on: false, robot: '0/1/1' }]);
});

// Runs in the page: whether a canvas has more than a handful of pixels with something on them.
function isDrawn(selector) {
  const canvas = document.querySelector(selector);
  if (!canvas || canvas.width === 0) return false;
  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  let drawn = 0;
  for (let at = 3; at < data.length; at += 4) if (data[at] > 0) drawn += 1;
  return drawn > 1000;
}
