// What the station sends to a page, as the page receives it: tests wait for what shall come, and read its times off the session's clock.

import assert from 'node:assert/strict';

// Only a test that fails waits so long.
const PATIENCE_MS = 30_000;
const MOST_FRAMES = 20_000;

export class Tap {
  constructor() {
    this.hello = null;
    this.frames = [];
    this.waiting = new Set();
  }

  /** Listens to the stream of a page; before it is opened. */
  listen(page) {
    page.on('websocket', (socket) => socket.on('framereceived', ({ payload }) => this.#take(JSON.parse(payload))));
  }

  /** The session's time of the last frame. */
  get now_s() {
    return this.frames.at(-1)?.now_s ?? this.hello?.now_s ?? 0;
  }

  /** The latest estimate. */
  get estimate() {
    return this.frames.findLast((frame) => estimatesOf(frame).length > 0)?.robots[0].estimates.at(-1) ?? null;
  }

  /**
   * The first frame, of those from `from_s` on, for which `find` gives something; gives what it gave and the frame's time.
   * @param {string} what what is waited for, for the message when it does not come.
   */
  until(what, find, from_s = this.now_s) {
    for (const frame of this.frames) {
      const found = frame.now_s > from_s ? find(frame) : null;
      if (found) return Promise.resolve({ found, now_s: frame.now_s });
    }
    return new Promise((resolve, reject) => {
      const wait = { find, from_s, resolve: (found, frame) => { clearTimeout(wait.timer); resolve({ found, now_s: frame.now_s }); } };
      wait.timer = setTimeout(() => {
        this.waiting.delete(wait);
        reject(new assert.AssertionError({ message: `did not come: ${what}; session at ${this.now_s} s, asked at ${from_s} s` }));
      }, PATIENCE_MS);
      this.waiting.add(wait);
    });
  }

  /** Waits until the session's clock has gone on. */
  pass(seconds) {
    const until_s = this.now_s + seconds;
    return this.until(`${seconds} s more`, (frame) => frame.now_s >= until_s || null);
  }

  #take(message) {
    if (message.type === 'hello') {
      this.hello = message;
      this.frames = [];
      return;
    }
    this.frames.push(message);
    if (this.frames.length > MOST_FRAMES) this.frames.shift();
    for (const wait of this.waiting) {
      const found = message.now_s > wait.from_s ? wait.find(message) : null;
      if (!found) continue;
      this.waiting.delete(wait);
      wait.resolve(found, message);
    }
  }
}

export function estimatesOf(frame) {
  return frame.robots?.[0]?.estimates ?? [];
}

export function fixesOf(frame) {
  return frame.robots?.[0]?.fixes ?? [];
}

export function fusionOf(frame) {
  return frame.robots?.[0]?.fusion ?? [];
}
