// Truth and estimate of a simulated robot on the page, live and in replay, as the page itself draws them.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { seeing, seen, waitForState } from './support/page.mjs';
import { Program, newFolder } from './support/station.mjs';

const DRIVE_S = 60;

let browser;

before(async () => {
  browser = await Browser.launch();
});

after(() => browser.close());

// Of the estimates that are drawn, in how many the truth beside them lies inside the drawn ellipse, from the page's own numbers.
function countInside(page) {
  return page.evaluate(() => {
    const counts = { inside: 0, all: 0, last_s: NaN, isOver: false };
    globalThis.countsInside = counts;
    const look = () => {
      const { t_s, truth_x_m, truth_y_m, x_m, y_m, major_m, minor_m, axis_rad } = document.getElementById('pose').dataset;
      if (t_s !== counts.last_s && truth_x_m !== undefined) {
        counts.last_s = t_s;
        const [dx, dy] = [truth_x_m - x_m, truth_y_m - y_m];
        const [along, across] = [dx * Math.cos(axis_rad) + dy * Math.sin(axis_rad), dy * Math.cos(axis_rad) - dx * Math.sin(axis_rad)];
        counts.all += 1;
        if ((along / major_m) ** 2 + (across / minor_m) ** 2 <= 1) counts.inside += 1;
      }
      if (!counts.isOver) requestAnimationFrame(look);
    };
    look();
  });
}

async function shareInside(page) {
  const { inside, all } = await page.evaluate(() => {
    globalThis.countsInside.isOver = true;
    return globalThis.countsInside;
  });
  return { share: inside / all, all };
}

// Whether the filter claims too much is a matter of its own tests. Drawn at two instants, three in four were inside; drawn a third too wide, all are.
function assertDrawnTruly(where, share) {
  assert.ok(share >= 0.9 && share <= 0.995, `${where} ${share}`);
}

test('the truth lies inside the drawn ellipse of 95 %, live and in replay', { timeout: 200_000 }, async () => {
  const station = Program.start(['run', '--link', 'sim://figure-eight', '--seed', '1', '--out', 'session', '--dashboard', '127.0.0.1:0'], await newFolder());
  try {
    const page = await browser.open(await station.address());
    page.setDefaultTimeout(2000 * DRIVE_S);
    await waitForState(page, 'live');
    await seeing(page, '#pose', () => document.getElementById('pose').dataset.truth_x_m !== undefined);
    await countInside(page);
    await seeing(page, '#pose', (end_s) => Number(document.getElementById('pose').dataset.t_s) > end_s, DRIVE_S);
    const live = await shareInside(page);
    assert.ok(live.all > 10 * DRIVE_S, `${live.all} estimates`);
    console.log(`live ${(100 * live.share).toFixed(1)} % of ${live.all}`);
    assertDrawnTruly('live', live.share);
    await seen(page, '#recordings', '#recordings [aria-label^="Replay "]');
    await page.locator('#recordings [aria-label^="Replay "]').first().click();
    await page.getByLabel('Speed of the replay').selectOption('5');
    await seeing(page, '#pose', (end_s) => Number(document.getElementById('pose').dataset.t_s) < end_s, DRIVE_S / 2);
    await countInside(page);
    await seeing(page, '#pose', (end_s) => Number(document.getElementById('pose').dataset.t_s) > end_s, DRIVE_S - 2);
    const replayed = await shareInside(page);
    assert.ok(replayed.all > 100, `${replayed.all} estimates`);
    console.log(`in replay ${(100 * replayed.share).toFixed(1)} % of ${replayed.all}`);
    assertDrawnTruly('in replay', replayed.share);
    await page.close();
    assert.equal(await station.stop(), 0);
  } finally {
    await station.remove();
  }
});
