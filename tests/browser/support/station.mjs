// The program that is tested, in a folder of its own.

import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { mkdtemp, rm } from 'node:fs/promises';
import os from 'node:os';
import path from 'node:path';

const PROGRAM = process.env.POSEBRIDGE;
const UI_DIR = process.env.BROWSER_UI_DIR;
// Only a test that fails waits so long.
const PATIENCE_MS = 60_000;

/** A new folder for a program. */
export function newFolder() {
  return mkdtemp(path.join(os.tmpdir(), 'posebridge-browser-'));
}

export class Program {
  /** Starts it in a folder, which `remove` deletes. */
  static start(args, folder) {
    const page = UI_DIR && args[0] === 'run' ? ['--ui-dir', UI_DIR] : [];
    return new Program(spawn(PROGRAM, [...args, ...page], { cwd: folder, stdio: ['ignore', 'pipe', 'pipe'] }), folder);
  }

  constructor(child, folder) {
    this.child = child;
    this.folder = folder;
    this.said = '';
    this.printed = '';
    this.ended = new Promise((resolve) => child.once('close', (code) => resolve(code)));
    this.waiting = [];
    const heard = () => { for (const tell of this.waiting.splice(0)) tell(); };
    child.stdout.on('data', (bytes) => { this.printed += bytes; heard(); });
    child.stderr.on('data', (bytes) => { this.said += bytes; heard(); });
  }

  get pid() {
    return this.child.pid;
  }

  /** All that it wrote. */
  get text() {
    return this.said + this.printed;
  }

  /** What a pattern finds in all that it wrote so far or will write. */
  finds(pattern) {
    return within(this.#findsInTime(pattern), `${pattern} in what it writes`, () => this.text);
  }

  async #findsInTime(pattern) {
    while (!pattern.test(this.text)) {
      if (this.child.exitCode !== null) assert.fail(`ended without ${pattern}:\n${this.text}`);
      const more = new Promise((resolve) => { this.waiting.push(resolve); });
      await Promise.race([more, this.ended]);
    }
    return this.text.match(pattern);
  }

  /** Where its page is. */
  async address() {
    return (await this.finds(/http:\/\/127\.0\.0\.1:\d+\//))[0];
  }

  /** Ctrl-C, and the code with which it ends. */
  async stop() {
    this.child.kill('SIGINT');
    return within(this.ended, 'its end after Ctrl-C', () => this.text);
  }

  /** Ends it in any case and deletes its folder. */
  async remove() {
    if (this.child.exitCode === null) this.child.kill('SIGKILL');
    await this.ended;
    await rm(this.folder, { recursive: true, force: true });
  }
}

/** Runs it to its end; gives what it said and printed, and fails when it fails. */
export async function run(args, folder) {
  const program = Program.start(args, folder);
  const code = await within(program.ended, `the end of ${args[0]}`, () => program.text);
  assert.equal(code, 0, program.text);
  return program.text;
}

function within(promise, what, text) {
  let timer;
  const late = new Promise((_, reject) => {
    timer = setTimeout(() => reject(new assert.AssertionError({ message: `did not come: ${what}\n${text()}` })), PATIENCE_MS);
  });
  return Promise.race([promise, late]).finally(() => clearTimeout(timer));
}
