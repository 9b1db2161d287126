// What the panels know of the station besides a session's data: parameters, sources, recordings, simulator; and how to ask it for things.

import { Fleet } from './fleet.js';
import { isRecord } from './model/session.js';
import { list } from './model/robot.js';

const MOST_PARAMETERS = 200;
const MOST_SWITCHES = 256;
const MOST_PLACES = 1000;

export class Station {
  /**
   * @param {{announce: (text: string, isError: boolean) => void, redraw: () => void, replay: (name: string) => void, isReplay: () => boolean,
   *   select: (id: string) => void, robot: () => (string | null)}} page
   */
  constructor(page) {
    this.page = page;
    this.isGreeted = false;
    this.version = '';
    /** Whether this page may give commands. */
    this.canCommand = true;
    this.simulator = null;
    /** What stands in the arena. */
    this.arena = arenaOf(null);
    /** The stations and robots of the fleet, if this station is in one. */
    this.fleet = new Fleet(() => this.redraw());
    this.sources = new Map();
    this.parameters = new Map();
    this.recordings = [];
    this.recording = null;
    this.switchedOff = new Set();
    // Counts what was told of switches: who shows them looks whether there is anything new.
    this.switchesTold = 0;
    /** The recording that was being written when the list was read; null if none was. */
    this.listed = null;
    /** Whether it is being read. */
    this.isReadingList = false;
  }

  /** Takes what a connection begins with. */
  greet(hello) {
    this.isGreeted = true;
    this.canCommand = hello.can_command !== false;
    this.version = String(hello.version ?? '').slice(0, 40);
    this.simulator = isRecord(hello.simulator) ? hello.simulator : null;
    this.arena = arenaOf(hello.arena);
    this.fleet.join(hello.fleet);
    this.#takeSources(hello.sources);
    this.parameters = new Map(list(hello.parameters).filter(isParameter).slice(0, MOST_PARAMETERS).map((parameter) => [parameter.name, parameter]));
    this.recordings = list(hello.recordings).filter(isRecord);
    this.recording = null;
    this.listed = this.recordings.find((row) => row.is_current)?.name ?? null;
    this.switchedOff = new Set();
    this.isComparing = false;
    this.#takeStanding(isRecord(hello.history) ? hello.history : {});
  }

  /** Takes what a frame says besides a session's data. */
  apply(frame) {
    for (const { name, value } of list(frame.parameters).filter(isRecord)) {
      const known = this.parameters.get(name);
      if (known && Number.isFinite(value)) known.value = value;
    }
    if (frame.recording !== undefined) this.#takeRecording(isRecord(frame.recording) ? frame.recording : null);
    this.#takeStanding(frame);
  }

  /** Whether a robot's filter uses a source, as far as the station told. */
  isUsed(sensor, robot = null) {
    return !(robot?.switchedOff ?? this.switchedOff).has(this.idOf(sensor));
  }

  // What holds until somebody commands something else, here or elsewhere.
  #takeStanding(frame) {
    if (Array.isArray(frame.switched_off)) {
      this.switchedOff = new Set(frame.switched_off.slice(0, MOST_SWITCHES));
      this.switchesTold += 1;
    }
    if (typeof frame.is_comparing === 'boolean') this.isComparing = frame.is_comparing;
    if (this.simulator && isRecord(frame.simulator)) {
      this.simulator.steering = frame.simulator.steering;
      this.simulator.link_profile = frame.simulator.link_profile;
    }
  }

  // Whoever began or ended one, here, in another browser or because a part was full: the list is another one.
  #takeRecording(recording) {
    this.recording = recording;
    const name = recording?.name ?? null;
    const isListed = name === null || this.recordings.some((row) => row.name === name);
    if (name === this.listed && (isListed || this.isReadingList)) return;
    this.listed = name;
    this.isReadingList = true;
    this.renewRecordings().finally(() => { this.isReadingList = false; });
  }

  /** The way-points of the simulated robot as pairs of metres. */
  path() {
    return list(this.simulator?.path).filter((point) => Array.isArray(point) && Number.isFinite(point[0]) && Number.isFinite(point[1]));
  }

  /** The number by which commands name a source; undefined where the station told none. */
  idOf(sensor) {
    return this.sources.get(sensor)?.id;
  }

  redraw() {
    this.page.redraw();
  }

  replay(name) {
    this.page.replay(name);
  }

  /** Chooses the robot that is shown, and that commands are for. */
  select(id) {
    this.page.select(id);
  }

  /** Sends a command for the chosen robot; see `command`. */
  commandRobot(command) {
    const robot = this.page.robot();
    return this.command(robot === null ? command : { ...command, robot });
  }

  /** Sends a command and says what became of it; gives whether it was taken. Never throws: what went wrong is shown. */
  async command(command) {
    if (this.page.isReplay()) {
      this.page.announce('A recording is shown: go back to live to tell the station something.', true);
      return;
    }
    if (!this.canCommand) {
      this.page.announce('Your token only lets you look: open the address of an operator to command the station.', true);
      return false;
    }
    const answer = await this.#ask('v1/commands', { method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify(command) });
    if (answer && command.command !== 'drive') this.page.announce(`${command.command}: sent`, false);
    return answer !== null;
  }

  /** Asks for the sources again: one was heard that was not known when the connection began. */
  async renewSources() {
    const found = await this.#ask('v1/sources');
    if (!Array.isArray(found)) return;
    this.#takeSources(found);
    this.switchesTold += 1;
    this.redraw();
  }

  #takeSources(rows) {
    this.sources = new Map(list(rows).filter(isRecord).map((source) => [String(source.name), source]));
  }

  async renewRecordings() {
    const answer = await this.#ask('v1/recordings');
    const found = Array.isArray(answer) ? answer : answer?.recordings;
    if (!found) return;
    this.recordings = list(found).filter(isRecord);
    this.redraw();
  }

  /** The tracks of a recording, or null when it cannot be had. */
  history(name) {
    return this.#ask(`v1/recordings/${encodeURIComponent(name)}/replay`);
  }

  // The answer as a value; null after an error, which is shown.
  async #ask(path, options) {
    try {
      const response = await fetch(path, options);
      const text = await response.text();
      const answer = text === '' ? {} : JSON.parse(text);
      if (response.ok) return answer;
      this.page.announce(String(answer.error ?? `${response.status} ${response.statusText}`).slice(0, 400), true);
    } catch (error) {
      this.page.announce(`The station does not answer (${error.message}).`, true);
    }
    return null;
  }
}

// Landmarks, beacons and walls; what is not as agreed is left out.
function arenaOf(said) {
  const isPlace = (place) => isRecord(place) && Number.isFinite(place.x_m) && Number.isFinite(place.y_m);
  const isWall = (ends) => Array.isArray(ends) && ends.length === 2 && ends.flat().length === 4 && ends.flat().every(Number.isFinite);
  const places = (rows) => list(rows).filter(isPlace).slice(0, MOST_PLACES);
  return { landmarks: places(said?.landmarks), beacons: places(said?.beacons), walls: list(said?.walls).filter(isWall).slice(0, MOST_PLACES) };
}

function isParameter(entry) {
  return isRecord(entry) && typeof entry.name === 'string' && [entry.value, entry.default, entry.least, entry.most].every(Number.isFinite);
}
