// The stream of the station: a WebSocket that comes back by itself.
//
// After a loss it tries again with growing pauses. The station may have been restarted meanwhile: every connection begins with `hello`, and
// whoever listens begins anew with it.

const FIRST_PAUSE_MS = 250;
const LONGEST_PAUSE_MS = 4000;
// A station says something at least once a second (links, recording). Silence for this long is a connection that died without a word.
const SILENCE_MS = 8000;

export class Stream {
  /** @param {{onMessage: (message: object) => void, onState: (state: string) => void}} listeners */
  constructor(address, listeners) {
    this.address = address;
    this.listeners = listeners;
    this.pause_ms = FIRST_PAUSE_MS;
    this.malformed = 0;
    this.socket = null;
    this.watch = 0;
  }

  open() {
    this.listeners.onState('connecting');
    const socket = new WebSocket(this.address);
    this.socket = socket;
    this.#watchSilence(socket);
    socket.addEventListener('message', (event) => this.#message(socket, event.data));
    socket.addEventListener('close', () => this.#lost(socket));
  }

  #message(socket, data) {
    this.#watchSilence(socket);
    let message;
    try {
      message = JSON.parse(data);
    } catch {
      this.malformed += 1;
      return;
    }
    if (message === null || typeof message !== 'object') {
      this.malformed += 1;
      return;
    }
    if (message.type === 'hello') {
      this.pause_ms = FIRST_PAUSE_MS;
      this.listeners.onState('live');
    }
    this.listeners.onMessage(message);
  }

  #watchSilence(socket) {
    clearTimeout(this.watch);
    this.watch = setTimeout(() => {
      socket.close();
      this.#lost(socket);
    }, SILENCE_MS);
  }

  #lost(socket) {
    if (socket !== this.socket) return;
    this.socket = null;
    clearTimeout(this.watch);
    this.listeners.onState('lost');
    // Up to a third more by chance, so that a class of browsers does not knock all at once.
    setTimeout(() => this.open(), this.pause_ms * (1 + Math.random() / 3));
    this.pause_ms = Math.min(2 * this.pause_ms, LONGEST_PAUSE_MS);
  }
}
