// What tests look at on the page.

/** Waits until the connection's badge says so. */
export async function waitForState(page, state) {
  await page.waitForFunction((wanted) => document.getElementById('connection').dataset.state === wanted, state);
}

/** The estimate that stands on the page: numbers at full precision. */
export async function poseOf(page) {
  const data = await page.evaluate(() => ({ ...document.getElementById('pose').dataset }));
  return Object.fromEntries(Object.entries(data).map(([name, value]) => [name, name === 'robot' ? value : Number(value)]));
}
