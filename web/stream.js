// The stream of the station: a WebSocket that comes back by itself.
//
// After a loss it tries again with growing pauses. The station may have been restarted meanwhile: every connection begins with `hello`, and
// whoever listens begins anew with it. One that asks for a token has another one then, and a WebSocket does not say why it was refused: that is
// asked for by an ordinary request.

const FIRST_PAUSE_MS = 250;
const LONGEST_PAUSE_MS = 4000;
// A station says something at least once a second (links, recording). Silence for this long is a connection that died without a word.
const SILENCE_MS = 8000;
const UNAUTHORISED = 401;

export class Stream {
  /** @param {{onMessage: (message: object) => void, onState: (state: string) => void}} listeners */
  constructor(address, listeners) {
    this.address = address;
    this.listeners = listeners;
    this.pause_ms = FIRST_PAUSE_MS;
    this.malformed = 0;
    this.hasHello = false;
    this.isRefused = false;
    this.socket = null;
    this.watch = 0;
    this.retry = 0;
  }

  open() {
    if (!this.isRefused) this.listeners.onState('connecting');
    const socket = new WebSocket(this.address);
    this.socket = socket;
    this.hasHello = false;
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
      this.hasHello = true;
      this.isRefused = false;
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
    if (!this.isRefused) this.listeners.onState('lost');
    if (!this.hasHello) this.#askWhy();
    // Up to a third more by chance, so that a class of browsers does not knock all at once.
    this.retry = setTimeout(() => this.open(), this.pause_ms * (1 + Math.random() / 3));
    this.pause_ms = Math.min(2 * this.pause_ms, LONGEST_PAUSE_MS);
  }

  // Another page of this browser may open the new address: its cookie holds for this one as well, so the tries go on.
  async #askWhy() {
    let status = 0;
    try {
      ({ status } = await fetch('v1/robots'));
    } catch {
      // Nobody answers at all: it is lost, as was said.
    }
    if (this.hasHello || (status === UNAUTHORISED) === this.isRefused) return;
    this.isRefused = status === UNAUTHORISED;
    this.listeners.onState(this.isRefused ? 'refused' : 'lost');
  }
}
