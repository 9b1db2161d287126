// A Chromium of this computer, and pages that must not complain.

import assert from 'node:assert/strict';
import { mkdtemp, rm } from 'node:fs/promises';
import os from 'node:os';
import path from 'node:path';
import { chromium } from 'playwright-core';

const ARGUMENTS = [
  '--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run',
  '--disable-background-networking', '--disable-component-update', '--disable-sync',
];

// Playwright evaluates what a test asks of the page with `eval`, from a script without an address. Chromium lets it, and on a busy machine now and then
// says half of its complaint all the same. What the page itself runs against its policy has the page's address or that of a script.
function isOfDriver(message) {
  return message.location().url === '' && message.text().startsWith(" Note that 'script-src' was not explicitly set");
}

// The other half of the same: an error that comes from no script of the page.
function isEvalOfDriver(error) {
  return error.name === 'EvalError' && !String(error.stack).includes('://');
}

// A complaint with the line that it is about: some come without any other hint.
function where(message) {
  const { url, lineNumber, columnNumber } = message.location();
  return `${message.text()} (${url}:${lineNumber + 1}:${columnNumber + 1})`;
}

/** A browser with a profile of its own, which `close` deletes. */
export class Browser {
  static async launch({ further = [], ignoreHTTPSErrors = false } = {}) {
    const profile = await mkdtemp(path.join(os.tmpdir(), 'posebridge-browser-'));
    const context = await chromium.launchPersistentContext(profile, {
      executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium', headless: true, args: [...ARGUMENTS, ...further], ignoreHTTPSErrors, chromiumSandbox: false,
      viewport: { width: 1440, height: 1000 }, acceptDownloads: true,
    });
    return new Browser(profile, context);
  }

  constructor(profile, context) {
    this.profile = profile;
    this.context = context;
    this.complaints = [];
    this.foreign = [];
  }

  /**
   * A page at an address, for which no other host exists: what it asks of one is noted and refused. `forgives` are texts of console
   * errors that a test brings about itself; `tap` hears the page's
   * stream; `own` is the only host when the address is not yet on it.
   */
  async open(address, { forgives = [], tap = null, own = new URL(address).origin } = {}) {
    const page = await this.context.newPage();
    tap?.listen(page);
    await page.route((url) => url.origin !== own && url.protocol !== 'data:' && url.protocol !== 'about:', (route) => {
      this.foreign.push(route.request().url());
      return route.abort();
    });
    page.on('console', (message) => {
      if (message.type() !== 'error' && message.type() !== 'warning') return;
      if (isOfDriver(message) || forgives.some((text) => message.text().includes(text))) return;
      this.complaints.push(where(message));
    });
    page.on('pageerror', (error) => { if (!isEvalOfDriver(error)) this.complaints.push(String(error)); });
    await page.goto(address, { waitUntil: 'domcontentloaded' });
    return page;
  }

  /** Ends, and fails when a page complained or asked another host. */
  async close() {
    await this.context.close();
    await rm(this.profile, { recursive: true, force: true });
    assert.deepEqual(this.complaints, [], 'the console stayed silent');
    assert.deepEqual(this.foreign, [], 'no other host was asked');
  }
}
