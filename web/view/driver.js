// Driving by hand: arrow keys or WASD while armed, or the buttons on a touch screen.
//
// The station holds a drive command for half a second and then stops the robot; while a key is down it is repeated faster than that. A
// page that goes away so stops the robot by itself.

import { button, element } from './dom.js';

const REPEAT_MS = 200;
// Half of what the simulated robot can do: it stays on a phone's screen.
const FORWARD_M_PER_S = 0.2;
const TURN_RAD_PER_S = 1.2;

const WAYS = new Map([
  ['forward', [FORWARD_M_PER_S, 0]],
  ['back', [-FORWARD_M_PER_S, 0]],
  ['left', [0, TURN_RAD_PER_S]],
  ['right', [0, -TURN_RAD_PER_S]],
]);

const KEYS = new Map([
  ['ArrowUp', 'forward'], ['ArrowDown', 'back'], ['ArrowLeft', 'left'], ['ArrowRight', 'right'],
  ['w', 'forward'], ['s', 'back'], ['a', 'left'], ['d', 'right'],
]);

export class Driver {
  /** @param {(command: object) => Promise<void>} send */
  constructor(send) {
    this.send = send;
    this.held = new Set();
    this.isArmed = false;
    this.timer = 0;
    this.isSending = false;
    this.isDue = false;
    document.addEventListener('keydown', (event) => this.#key(event, true), { capture: true });
    document.addEventListener('keyup', (event) => this.#key(event, false), { capture: true });
    globalThis.addEventListener('blur', () => this.#release());
  }

  build() {
    this.arm = button('Drive with the keys', () => (this.isArmed ? this.disarm() : this.#arm()), { 'aria-pressed': 'false', class: 'act', title: 'Arrow keys or WASD; Escape ends it' });
    this.pad = element('div', { class: 'pad', role: 'group', 'aria-label': 'Drive' },
      this.#padButton('left', '◀'), this.#padButton('forward', '▲'), this.#padButton('back', '▼'), this.#padButton('right', '▶'));
    const path = button('Back to the path', () => { this.disarm(); this.send({ command: 'path' }); });
    this.pad.hidden = true;
    return element('div', { class: 'hand drive' }, this.arm, path, this.pad);
  }

  disarm() {
    if (!this.isArmed) return;
    this.isArmed = false;
    this.#show();
    this.#release();
  }

  #arm() {
    this.isArmed = true;
    this.#show();
  }

  #show() {
    this.arm.setAttribute('aria-pressed', String(this.isArmed));
    this.pad.hidden = !this.isArmed;
  }

  #padButton(way, sign) {
    const made = button(sign, () => {}, { 'aria-label': `Drive ${way}` });
    made.addEventListener('pointerdown', () => this.#hold(way));
    for (const end of ['pointerup', 'pointercancel', 'pointerleave']) made.addEventListener(end, () => this.#let(way));
    return made;
  }

  #key(event, isDown) {
    if (!this.isArmed || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === 'Escape') {
      this.disarm();
      return;
    }
    const way = KEYS.get(event.key.length === 1 ? event.key.toLowerCase() : event.key);
    if (!way || event.target.matches('input, select, textarea')) return;
    event.preventDefault();
    event.stopPropagation();
    if (isDown) this.#hold(way);
    else this.#let(way);
  }

  #hold(way) {
    if (this.held.has(way)) return;
    this.held.add(way);
    this.#say();
    if (this.timer === 0) this.timer = setInterval(() => this.#say(), REPEAT_MS);
  }

  #let(way) {
    if (!this.held.delete(way)) return;
    this.#say();
    if (this.held.size === 0) this.#stopTimer();
  }

  #release() {
    if (this.held.size === 0) return;
    this.held.clear();
    this.#stopTimer();
    this.#say();
  }

  #stopTimer() {
    clearInterval(this.timer);
    this.timer = 0;
  }

  // One at a time and the newest: two on their way at once might overtake each other, and a stop be followed by a drive.
  async #say() {
    this.isDue = true;
    if (this.isSending) return;
    this.isSending = true;
    while (this.isDue) {
      this.isDue = false;
      await this.send(this.#command());
    }
    this.isSending = false;
  }

  #command() {
    let forward_m_per_s = 0;
    let turn_rad_per_s = 0;
    for (const way of this.held) {
      const [forward, turn] = WAYS.get(way);
      forward_m_per_s += forward;
      turn_rad_per_s += turn;
    }
    return { command: 'drive', forward_m_per_s, turn_rad_per_s };
  }
}
