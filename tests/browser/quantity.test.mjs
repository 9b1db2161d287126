// Filters of one quantity and thermometers on the page, with the real program on both ends of a TCP link.

import assert from 'node:assert/strict';
import { writeFile } from 'node:fs/promises';
import path from 'node:path';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { seeing, waitForState } from './support/page.mjs';
import { Program, newFolder } from './support/station.mjs';

const PERIOD_MS = 80;
const READINGS = 40;
// One reading sees a passer-by.
const REFUSED_AT = 25;
const PASSER_BY_M = 0.2;

let browser;

before(async () => {
  browser = await Browser.launch();
});

after(() => browser.close());

// A car that drives at a wall with 0.2 m/s, as a descriptor with its table.
async function wallApproach(folder) {
  const lines = Array.from({ length: READINGS }, (_, index) => {
    const time_ms = index * PERIOD_MS;
    return `${time_ms},${index === REFUSED_AT ? PASSER_BY_M : (2 - 0.0002 * time_ms).toFixed(3)}`;
  });
  await writeFile(path.join(folder, 'approach.csv'), `time_ms,distance_m\n${lines.join('\n')}\n`);
  await writeFile(path.join(folder, 'approach.toml'), `
name = "approach"
source = "a test"
licence = "none"
default_run = "car"
[robot]
name = "car"
left_wheel_radius_m = 0.04
right_wheel_radius_m = 0.04
track_width_m = 0.14
ticks_per_turn = 1000.0
[robot.noise]
wall_range_m = 0.01
[[runs]]
name = "car"
values = { file = "approach" }
[files.table]
path = "{file}.csv"
header_lines = 1
time = { column = "time_ms", unit = "ms" }
[[wall_range]]
file = "table"
range = { column = "distance_m", unit = "m" }
`);
}

// What stands in the only row of a panel's table, by the names of its columns.
function rowOf(page, id) {
  return page.evaluate((panel) => {
    const texts = (selector) => [...document.querySelectorAll(`#${panel} ${selector}`)].map((cell) => cell.textContent);
    const values = texts('tbody tr > *');
    return Object.fromEntries(texts('thead th').map((name, index) => [name, values[index]]));
  }, id);
}

// Which of these colours of the palette are drawn in a chart, with a little room for smoothing.
function drawnIn(page, chart, names) {
  return page.evaluate(([label, wanted]) => {
    const canvas = document.querySelector(`.chart[aria-label^="${label}"] canvas`);
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    return wanted.filter((name) => {
      const hex = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
      const colour = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
      for (let at = 0; at < data.length; at += 4) {
        if (data[at + 3] > 200 && colour.every((part, index) => Math.abs(part - data[at + index]) < 12)) return true;
      }
      return false;
    });
  }, [chart, names]);
}

test('a car at a wall: readings, estimate, refused ones and its silence', async () => {
  const folder = await newFolder();
  await wallApproach(folder);
  const car = Program.start(['play', 'approach.toml', '--data', '.', '--listen', 'tcp://127.0.0.1:0'], folder);
  const [, port] = await car.finds(/listening on 127\.0\.0\.1:(\d+)/);
  const args = ['run', '--filter', 'range-kf', '--link', `tcp://127.0.0.1:${port}`, '--out', 'session', '--dashboard', '127.0.0.1:0'];
  const station = Program.start(args, await newFolder());
  try {
    const page = await browser.open(await station.address());
    await waitForState(page, 'live');
    const shows = (wanted) => seeing(page, '#quantity', (texts) => {
      const row = document.querySelector('#quantity tbody tr')?.textContent ?? '';
      return texts.some((text) => row.includes(text));
    }, wanted);
    await shows(['live']);
    await shows(['silent for', 'lost']);
    const row = await rowOf(page, 'quantity');
    assert.equal(row.quantity, 'distance to the wall');
    assert.equal(row.reading, '1.380 m', 'the message carries centimetres');
    assert.match(row['estimate ± 95 %'], /^1\.3\d\d ± 0\.0\d\d m$/);
    assert.match(row.rate, /^-0\.\d{3} m\/s$/);
    assert.equal(row['last reading'], 'accepted');
    const [, steps] = row['predicted only'].match(/^[123] % of (\d+)$/) ?? assert.fail(row['predicted only']);
    assert.ok(steps > READINGS / 2 && steps <= READINGS, `${steps} steps`);
    const colours = ['estimate', 'accepted', 'gated'];
    assert.deepEqual(await drawnIn(page, 'distance to the wall', colours), colours);
    assert.deepEqual(await drawnIn(page, 'Rate of distance to the wall', colours), ['estimate']);
    // There is no pose: nothing of it stands empty on the page.
    for (const id of ['arena', 'error', 'comparison', 'calibration', 'thermometers']) assert.equal(await page.locator(`#${id}`).isVisible(), false, id);
    assert.match(await page.locator('#silence').textContent(), /^robot silent for \d+ s$/);
    await page.setViewportSize({ width: 360, height: 740 });
    await shows(['silent for', 'lost']);
    assert.ok(await page.evaluate(() => document.documentElement.scrollWidth) <= 360);
    await page.close();
    assert.equal(await station.stop(), 0);
    assert.match(station.text, /quantity {3}last reading accepted, [123] % of \d+ steps by prediction alone/);
  } finally {
    await station.remove();
    await car.remove();
  }
});

test('a thermometer beside a pose: what it shows and where it will end', async () => {
  const brick = Program.start(['sim', 'thermometer', '--listen', 'tcp://127.0.0.1:0'], await newFolder());
  const [, port] = await brick.finds(/listening on 127\.0\.0\.1:(\d+)/);
  const station = Program.start(['run', '--link', `tcp://127.0.0.1:${port}`, '--out', 'session', '--dashboard', '127.0.0.1:0'], await newFolder());
  try {
    const page = await browser.open(await station.address());
    await waitForState(page, 'live');
    await seeing(page, '#thermometers', () => / ± /.test(document.querySelector('#thermometers tbody tr')?.textContent ?? ''));
    const row = await rowOf(page, 'thermometers');
    assert.equal(row.thermometer, 'temp1');
    assert.equal(row.state, 'live');
    assert.match(row.shown, /^(19|20)\.\d\d °C$/);
    await seeing(page, '#thermometers', () => Number(document.querySelector('#thermometers tbody tr').textContent.match(/% of (\d+)/)?.[1]) > 12);
    assert.deepEqual(await drawnIn(page, 'temp1', ['estimate', 'accepted', 'gated']), ['estimate', 'accepted']);
    assert.equal(await page.locator('#arena').isVisible(), true);
    assert.equal(await page.locator('#quantity').isVisible(), false, 'its filter is one of a pose');
    await page.close();
  } finally {
    await station.remove();
    await brick.remove();
  }
});
