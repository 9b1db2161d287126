// What tests look at on the page.

/** Waits until the connection's badge says so. */
export async function waitForState(page, state) {
  await page.waitForFunction((wanted) => document.getElementById('connection').dataset.state === wanted, state);
}

/**
 * Waits for something while a part of the page is kept in sight: what is out of sight is not drawn, and parts above it grow when they are drawn
 * first. `holds` runs in the page.
 */
export async function seeing(page, part, holds, argument = null) {
  await page.evaluate((selector) => {
    const own = {};
    globalThis.keptInSight = own;
    const look = () => {
      if (globalThis.keptInSight !== own) return;
      document.querySelector(selector)?.scrollIntoView({ block: 'nearest' });
      requestAnimationFrame(look);
    };
    look();
  }, part);
  try {
    return await page.waitForFunction(holds, argument);
  } finally {
    await page.evaluate(() => { globalThis.keptInSight = null; });
  }
}

/** The same until something is there; then it can be worked. */
export function seen(page, part, wanted) {
  return seeing(page, part, (selector) => document.querySelector(selector) !== null, wanted);
}

/** The estimate that stands on the page: numbers at full precision. */
export async function poseOf(page) {
  const data = await page.evaluate(() => ({ ...document.getElementById('pose').dataset }));
  return Object.fromEntries(Object.entries(data).map(([name, value]) => [name, name === 'robot' ? value : Number(value)]));
}
