// Looking at a recording again: a session of its own, a time that is shown, and the bar with the scrubber.

import { Session } from './model/session.js';
import { button, element, setText } from './view/dom.js';
import { clockTime } from './view/format.js';

// As many points as a station sends of a recording.
const CAPACITY = 20_000;
const SPEEDS = [1, 2, 5, 20];

export class Replay {
  /** @param {HTMLElement} bar @param {() => void} onEnd */
  constructor(bar, onEnd) {
    this.bar = bar;
    this.onEnd = onEnd;
    this.session = null;
    this.until_s = 0;
    this.isPlaying = false;
    this.last_ms = NaN;
  }

  get isOn() {
    return this.session !== null;
  }

  /** Begins with what the station computed of a recording; says whether there is anything in it. */
  begin(name, history) {
    const session = new Session(CAPACITY, CAPACITY);
    session.apply(history);
    const span = session.span();
    if (!span) return false;
    this.session = session;
    this.span = span;
    this.until_s = span.from_s;
    this.isPlaying = true;
    this.last_ms = NaN;
    this.#build(name);
    return true;
  }

  end() {
    this.session = null;
    this.bar.hidden = true;
    this.bar.replaceChildren();
    this.onEnd();
  }

  /** Moves on with the screen's time. */
  advance(now_ms) {
    if (this.isPlaying && !Number.isNaN(this.last_ms)) {
      this.until_s = Math.min(this.span.to_s, this.until_s + (Number(this.speed.value) * (now_ms - this.last_ms)) / 1000);
      if (this.until_s >= this.span.to_s) this.#play(false);
      this.slider.value = String(this.until_s);
      this.#show();
    }
    this.last_ms = now_ms;
  }

  #build(name) {
    const { from_s, to_s } = this.span;
    this.playButton = button('Pause', () => this.#play(!this.isPlaying));
    this.slider = element('input', { type: 'range', min: from_s, max: to_s, step: 'any', value: from_s, 'aria-label': 'Time in the recording' });
    this.slider.addEventListener('input', () => {
      this.until_s = Number(this.slider.value);
      this.#show();
    });
    this.slider.addEventListener('keydown', (event) => this.#key(event));
    this.time = element('output', { class: 'number' });
    this.speed = element('select', { 'aria-label': 'Speed of the replay' }, ...SPEEDS.map((speed) => element('option', { value: speed, text: `${speed}×` })));
    this.bar.replaceChildren(element('strong', { text: `Replay of ${name}` }), this.playButton, this.slider, this.time, this.speed, button('Back to live', () => this.end()));
    this.bar.hidden = false;
    this.#show();
  }

  // A step of the keys is a fifth of a second, not a millionth of the recording.
  #key(event) {
    const step_s = { ArrowLeft: -0.2, ArrowRight: 0.2, PageDown: -5, PageUp: 5 }[event.key];
    if (step_s === undefined) return;
    event.preventDefault();
    this.until_s = Math.min(this.span.to_s, Math.max(this.span.from_s, this.until_s + step_s));
    this.slider.value = String(this.until_s);
    this.#show();
  }

  #play(isPlaying) {
    if (isPlaying && this.until_s >= this.span.to_s) this.until_s = this.span.from_s;
    this.isPlaying = isPlaying;
    setText(this.playButton, isPlaying ? 'Pause' : 'Play');
  }

  #show() {
    setText(this.time, `${clockTime(this.until_s - this.span.from_s)} / ${clockTime(this.span.to_s - this.span.from_s)}`);
    this.slider.setAttribute('aria-valuetext', this.time.textContent);
  }
}
