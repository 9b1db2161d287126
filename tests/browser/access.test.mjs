// Who cannot see colours, has no mouse or only a phone: names, contrast, keyboard, width. On a made-up station with everything shown.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { Browser } from './support/browser.mjs';
import { FakeStation } from './support/fake_station.mjs';
import { waitForState } from './support/page.mjs';

// Contrast of text by the Web Content Accessibility Guidelines 2.2, criterion 1.4.3, level AA.
const LEAST_CONTRAST = 4.5;

let browser;
let station;
let page;

before(async () => {
  station = new FakeStation({ robots: Array.from({ length: 64 }, (_, index) => `0/${index + 1}/1`), names: { '0/1/1': 'a robot with a name as long as that of a whole team of four' } });
  await station.open();
  browser = await Browser.launch();
  page = await browser.open(station.address);
  await waitForState(page, 'live');
  station.advance(120);
  // No robot has a pose and a quantity: here all panels are to be seen.
  const quantity = (name, kind, unit) => ({ t_s: station.now_s, name, kind, unit, reading: 1.2, verdict: 'gated', estimate: 1.3, bound_95: 0.1, rate_per_s: -0.2, steps: 9, predicted: 3 });
  const quantities = [quantity('', 'wall_range', 'm'), quantity('temperature of the water', 'temperature', '°C')];
  station.send({ type: 'frame', now_s: station.now_s, robots: [{ id: '0/1/1', quantities }] });
  await page.getByRole('button', { name: 'Drive with the keys' }).click();
  // A panel is drawn when it is seen first, and panels take turns: one a frame of the screen.
  const ids = await page.locator('.panel').evaluateAll((panels) => panels.map((panel) => panel.id));
  for (const id of ids) {
    station.advance(1);
    await page.evaluate(seeForFrames, [id, ids.length + 3]);
  }
  await page.waitForFunction(() => document.querySelectorAll('#calibration tbody tr').length === 2 && document.querySelectorAll('.parameter').length === 3);
});

// Runs in the page: keeps a panel in sight for some frames of the screen.
function seeForFrames([id, frames]) {
  return new Promise((done) => {
    let left = frames;
    const step = () => {
      document.getElementById(id).scrollIntoView({ block: 'nearest' });
      left -= 1;
      if (left > 0) requestAnimationFrame(step);
      else done();
    };
    step();
  });
}

after(async () => {
  await page.close();
  await station.close();
  await browser.close();
});

test('everything that can be worked has a name', async () => {
  const nameless = await page.evaluate(() => {
    const named = (node) => node.getAttribute('aria-label') || node.textContent.trim() || [...(node.labels ?? [])].some((label) => label.textContent.trim());
    return [...document.querySelectorAll('button, a, input, select, canvas[role], [tabindex="0"]')]
      .filter((node) => !named(node)).map((node) => node.outerHTML.slice(0, 200));
  });
  assert.deepEqual(nameless, []);
  const roles = await page.evaluate(() => [document.documentElement.lang, document.querySelectorAll('main').length, document.querySelectorAll('header.top').length, document.title]);
  assert.deepEqual(roles, ['en', 1, 1, 'posebridge']);
});

for (const theme of ['light', 'dark']) {
  test(`text can be read in ${theme} colours`, async () => {
    await page.emulateMedia({ colorScheme: theme, reducedMotion: 'reduce' });
    await page.waitForFunction((wanted) => document.documentElement.dataset.theme === wanted, theme);
    const { seen, poor } = await page.evaluate(poorContrast, LEAST_CONTRAST);
    assert.ok(seen > 150, `${seen} texts were looked at`);
    assert.deepEqual(poor, []);
    for (const name of ['other', 'estimate', 'faint']) {
      const contrast = await page.evaluate(contrastOnMap, name);
      assert.ok(contrast >= LEAST_CONTRAST, `names on the map, ${name}: ${contrast}`);
    }
  });
}

// Runs in the page: every element with text of its own against the first ground behind it that is not transparent.
function poorContrast(least) {
  const numbers = (colour) => colour.match(/[\d.]+/g).map(Number);
  const luminance = ([red, green, blue]) => {
    const [r, g, b] = [red, green, blue].map((part) => (part / 255 <= 0.03928 ? part / 255 / 12.92 : ((part / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = (node) => {
    for (let at = node; at; at = at.parentElement) {
      const colour = numbers(getComputedStyle(at).backgroundColor);
      if (colour.length === 3 || colour[3] > 0.99) return colour;
    }
    return [255, 255, 255];
  };
  const poor = [];
  let seen = 0;
  for (const node of document.querySelectorAll('body *')) {
    const hasText = [...node.childNodes].some((child) => child.nodeType === Node.TEXT_NODE && child.textContent.trim() !== '');
    const isDisabled = node.matches(':disabled');
    if (!hasText || isDisabled || node.getClientRects().length === 0) continue;
    seen += 1;
    const [text, behind] = [luminance(numbers(getComputedStyle(node).color)), luminance(ground(node))];
    const contrast = (Math.max(text, behind) + 0.05) / (Math.min(text, behind) + 0.05);
    if (contrast < least) poor.push(`${contrast.toFixed(2)}: ${node.outerHTML.slice(0, 120)}`);
  }
  return { seen, poor };
}

// Runs in the page: a colour that the map writes with against the map's ground.
function contrastOnMap(name) {
  const style = getComputedStyle(document.documentElement);
  const luminance = (property) => {
    const parts = style.getPropertyValue(property).trim().match(/[0-9a-f]{2}/gi).map((part) => parseInt(part, 16) / 255);
    const [r, g, b] = parts.map((part) => (part <= 0.03928 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const [text, ground] = [luminance(`--${name}`), luminance('--panel')];
  return (Math.max(text, ground) + 0.05) / (Math.min(text, ground) + 0.05);
}

test('the keyboard reaches every panel, and shows where it is', async () => {
  await page.locator('.skip').focus();
  assert.ok(await page.locator('.skip').evaluate((link) => link.getBoundingClientRect().left >= 0), 'the first stop is a way past the header');
  const reached = new Set();
  for (let press = 0; press < 150; press += 1) {
    await page.keyboard.press('Tab');
    const at = await page.evaluate(() => {
      const node = document.activeElement;
      if (!node || node === document.body) return null;
      const style = getComputedStyle(node);
      return { panel: node.closest('.panel')?.id ?? '', isShown: style.outlineStyle !== 'none' && parseFloat(style.outlineWidth) >= 2, what: node.outerHTML.slice(0, 100) };
    });
    if (!at) break;
    assert.ok(at.isShown, `the focus is seen on ${at.what}`);
    reached.add(at.panel);
  }
  for (const panel of ['robots', 'arena', 'simulator', 'innovations', 'calibration', 'parameters', 'log', 'recordings']) assert.ok(reached.has(panel), `${panel} is reached`);
});

// Runs in the page: what reaches beyond the right edge and is not in a box that scrolls by itself.
function stickingOut() {
  const isScrolled = (node) => node.closest('.scroll, .log, .parameters, .skip, .unseen, .u-wrap');
  return [...document.querySelectorAll('body *')]
    .filter((node) => node.getClientRects().length > 0 && !isScrolled(node) && node.getBoundingClientRect().right > innerWidth + 1)
    .map((node) => node.outerHTML.slice(0, 120));
}

for (const width of [320, 390, 699, 700, 1000, 1440]) {
  test(`nothing sticks out at ${width} pixels`, async () => {
    await page.setViewportSize({ width, height: 844 });
    // Charts follow their panels with the next frame.
    await page.waitForFunction(`(${stickingOut})().length === 0`).catch(() => {});
    assert.deepEqual(await page.evaluate(stickingOut), []);
    assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth));
    const columns = await page.evaluate(() => new Set([...document.querySelectorAll('.panel:not([hidden])')].map((panel) => Math.round(panel.getBoundingClientRect().left))).size);
    assert.equal(columns === 1, width < 700, `${columns} columns`);
  });
}

test('on a phone sliders can be set, and a swipe on the map scrolls the page', async () => {
  await page.setViewportSize({ width: 375, height: 740 });
  await page.locator('#parameters').scrollIntoViewIfNeeded();
  const widths = await page.locator('.parameter input[type="range"]').evaluateAll((sliders) => sliders.map((slider) => slider.getBoundingClientRect().width));
  assert.ok(widths.every((width) => width >= 220), widths.join(', '));
  assert.equal(await page.locator('.map canvas').evaluate((map) => getComputedStyle(map).touchAction), 'pan-y');
});
