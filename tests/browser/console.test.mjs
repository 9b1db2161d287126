// That the other tests would notice: a page that complains, or asks another host, fails the test that opened it.

import assert from 'node:assert/strict';
import { createServer } from 'node:http';
import { once } from 'node:events';
import { test } from 'node:test';
import { Browser } from './support/browser.mjs';

const POLICY = "default-src 'self'; img-src 'self' data: http://other.invalid";

// A server of one page and one script, and the complaints of a browser that has opened it.
async function complaintsAbout({ html = '', script = '' }) {
  const server = createServer((request, response) => {
    const isScript = request.url === '/own.js';
    response.writeHead(200, { 'Content-Type': isScript ? 'text/javascript' : 'text/html', 'Content-Security-Policy': POLICY });
    response.end(isScript ? `${script}\ndocument.documentElement.dataset.done = 'yes';` : `<!doctype html><link rel="icon" href="data:,">${html}<script src="/own.js"></script>`);
  });
  server.listen(0, '127.0.0.1');
  await once(server, 'listening');
  const browser = await Browser.launch();
  try {
    const page = await browser.open(`http://127.0.0.1:${server.address().port}/`);
    await page.locator('html[data-done="yes"]').waitFor({ state: 'attached' });
    return { complaints: browser.complaints.splice(0), foreign: browser.foreign.splice(0) };
  } finally {
    await browser.close();
    server.close();
  }
}

test('a page that does nothing wrong has no complaint', async () => {
  assert.deepEqual(await complaintsAbout({}), { complaints: [], foreign: [] });
});

test('code made from text, code in the page and an error are complaints', async () => {
  for (const page of [{ script: "try { eval('1'); } catch {}" }, { html: '<script>1</script>' }, { script: "console.error('no')" }, { script: "queueMicrotask(() => { throw new Error('no'); });" }]) {
    const { complaints } = await complaintsAbout(page);
    assert.equal(complaints.length, 1, `${JSON.stringify(page)}: ${JSON.stringify(complaints)}`);
  }
});

test('another host is noticed', async () => {
  const { foreign } = await complaintsAbout({ html: '<img src="http://other.invalid/a.png" alt="">' });
  assert.deepEqual(foreign, ['http://other.invalid/a.png']);
});
