// Recordings: start, stop, download, look at again.

import { button, element, scrolled, setText } from '../view/dom.js';
import { age, bytes } from '../view/format.js';

export const recordings = {
  id: 'recordings',
  title: 'Recordings',
  build: (body, station) => new RecordingsPanel(body, station),
};

class RecordingsPanel {
  constructor(body, station) {
    this.station = station;
    this.state = element('p', { class: 'note', id: 'recording-state' });
    this.start = button('Start', () => this.#ask('start-recording'), { 'aria-label': 'Start a recording' });
    this.stop = button('Stop', () => this.#ask('stop-recording'), { 'aria-label': 'Stop the recording' });
    this.table = element('tbody');
    this.known = null;
    this.sizes = new Map();
    body.append(
      element('div', { class: 'actions' }, this.start, this.stop, button('Look again', () => this.#renew(), { 'aria-label': 'Look again for recordings' })),
      this.state,
      scrolled('Recordings of this run', element('table', {},
        element('thead', {}, element('tr', {}, ...['recording', 'begun', 'size', 'actions'].map((text) => element('th', { scope: 'col', text })))), this.table)),
    );
  }

  draw({ stalled_s }) {
    const { recording, recordings: known } = this.station;
    const state = recording ? `Recording ${recording.name}, ${bytes(recording.bytes)}` : 'Not recording.';
    setText(this.state, stalled_s > 0 ? `${age(stalled_s)} ago: ${state}` : state);
    this.state.classList.toggle('stale', stalled_s > 0);
    this.start.disabled = Boolean(recording);
    this.stop.disabled = !recording;
    if (known !== this.known) {
      this.known = known;
      this.sizes.clear();
      this.table.replaceChildren(...known.map((entry) => this.#row(entry)));
    }
    const size = recording && this.sizes.get(recording.name);
    if (size) setText(size, bytes(recording.bytes));
  }

  #row(entry) {
    const name = String(entry.name);
    const size = element('td', { class: 'number', text: bytes(entry.bytes) });
    this.sizes.set(name, size);
    return element('tr', {},
      element('th', { scope: 'row', class: 'name', text: name }),
      element('td', { text: begun(entry.begun) }),
      size,
      element('td', { class: 'actions' },
        element('a', { class: 'button', href: `v1/recordings/${encodeURIComponent(name)}`, download: name, 'aria-label': `Download ${name}`, text: 'Download' }),
        button('Replay', () => this.station.replay(name), { 'aria-label': `Replay ${name}` })));
  }

  async #ask(command) {
    await this.station.command({ command });
    await this.#renew();
  }

  async #renew() {
    await this.station.renewRecordings();
  }
}

// Seconds since 1970 as this computer's date and time.
function begun(unix_s) {
  return Number.isFinite(unix_s) ? new Date(1000 * unix_s).toLocaleString() : '–';
}
