// A Firefox of this computer, spoken to by WebDriver BiDi (https://w3c.github.io/webdriver-bidi/), which it has built in.

import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { mkdtemp, rm } from 'node:fs/promises';
import os from 'node:os';
import path from 'node:path';
import { WebSocket } from 'ws';

export class Firefox {
  /** Starts one with a profile of its own, and opens an empty page. */
  static async launch() {
    const profile = await mkdtemp(path.join(os.tmpdir(), 'posebridge-firefox-'));
    const child = spawn(process.env.FIREFOX ?? '/usr/bin/firefox-esr', ['--headless', '--no-remote', '--profile', profile, '--remote-debugging-port', '0'], {
      stdio: ['ignore', 'ignore', 'pipe'], env: { ...process.env, HOME: profile },
    });
    const firefox = new Firefox(profile, child);
    await firefox.#connect();
    return firefox;
  }

  constructor(profile, child) {
    this.profile = profile;
    this.child = child;
    this.complaints = [];
    this.asked = new Map();
    this.number = 0;
  }

  /** Loads a page. */
  async open(address) {
    await this.#ask('browsingContext.navigate', { context: this.context, url: address, wait: 'complete' });
  }

  /** What an expression gives on the page; promises are awaited. Values only. */
  async evaluate(expression) {
    const { result, exceptionDetails } = await this.#ask('script.evaluate', { expression, target: { context: this.context }, awaitPromise: true });
    assert.equal(exceptionDetails, undefined, exceptionDetails?.text);
    return result.value;
  }

  /** Waits, frame by frame of the screen, until an expression holds on the page. */
  until(expression) {
    return this.evaluate(`new Promise((done) => { const look = () => ((${expression}) ? done(true) : requestAnimationFrame(look)); look(); })`);
  }

  async close() {
    this.socket.close();
    this.child.kill('SIGTERM');
    await new Promise((resolve) => this.child.once('close', resolve));
    await rm(this.profile, { recursive: true, force: true });
    assert.deepEqual(this.complaints, [], 'the console stayed silent');
  }

  async #connect() {
    const address = await new Promise((resolve, reject) => {
      let said = '';
      this.child.stderr.on('data', (bytes) => {
        said += bytes;
        const found = /WebDriver BiDi listening on (ws:\S+)/.exec(said);
        if (found) resolve(found[1]);
      });
      this.child.once('close', () => reject(new Error(`Firefox ended: ${said}`)));
    });
    this.socket = new WebSocket(`${address}/session`);
    this.socket.on('message', (text) => this.#heard(JSON.parse(text)));
    await new Promise((resolve, reject) => { this.socket.on('open', resolve).on('error', reject); });
    await this.#ask('session.new', { capabilities: {} });
    await this.#ask('session.subscribe', { events: ['log.entryAdded'] });
    ({ context: this.context } = await this.#ask('browsingContext.create', { type: 'tab' }));
  }

  #ask(method, params) {
    this.number += 1;
    this.socket.send(JSON.stringify({ id: this.number, method, params }));
    return new Promise((resolve, reject) => this.asked.set(this.number, { resolve, reject }));
  }

  #heard(message) {
    if (message.method === 'log.entryAdded' && message.params.level === 'error') this.complaints.push(message.params.text);
    const waiting = this.asked.get(message.id);
    if (!waiting) return;
    this.asked.delete(message.id);
    if (message.type === 'error') waiting.reject(new Error(`${message.error}: ${message.message}`));
    else waiting.resolve(message.result);
  }
}
