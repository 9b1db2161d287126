// A made-up station: serves web/ and speaks the stream as the program does. It is for what the program never says or does on demand:
// several robots, nonsense, silence, a loss in the middle. All time is virtual and moves with `advance`.

import { EventEmitter, once } from 'node:events';
import { createServer } from 'node:http';
import { readFile } from 'node:fs/promises';
import path from 'node:path';
import { fileURLToPath } from 'node:url';
import { WebSocketServer } from 'ws';

const WEB = fileURLToPath(new URL('../web/', import.meta.url));
const TYPES = { '.html': 'text/html', '.js': 'text/javascript', '.css': 'text/css', '.svg': 'image/svg+xml' };
const SIDE_M = 1;
const SPEED_M_PER_S = 0.2;

export class FakeStation {
  constructor({ robots = ['0/1/1'], names = {} } = {}) {
    this.robots = robots;
    this.names = names;
    this.now_s = 0;
    this.commands = [];
    this.commanded = new EventEmitter();
    this.history = { robots: [] };
    this.switchedOff = [];
    this.sources = SOURCES;
    this.recordings = RECORDINGS;
    this.simulator = { steering: 'estimate', link_profile: null };
    this.replay = null;
    this.refusal = null;
    this.isSilent = false;
    this.canCommand = true;
    this.arena = { landmarks: [], beacons: [], walls: [] };
    /** What `/v1/fleet` answers; null for a station that is in no fleet. */
    this.fleet = null;
  }

  /** Listens on loopback; the port of an earlier `open` is taken again. */
  async open() {
    this.server = createServer((request, response) => this.#answer(request, response));
    this.sockets = new WebSocketServer({ server: this.server, path: '/v1/stream' });
    this.sockets.on('connection', (socket) => socket.send(JSON.stringify(this.hello())));
    await new Promise((resolve) => this.server.listen(this.port ?? 0, '127.0.0.1', resolve));
    this.port = this.server.address().port;
    // As the program, which says something at least once a second; unless it shall be silent.
    this.heart = setInterval(() => { if (!this.isSilent) this.send({ type: 'frame', now_s: this.now_s }); }, 500);
    this.address = `http://127.0.0.1:${this.port}/`;
  }

  /** Ends at once, as a killed program would. */
  async close() {
    clearInterval(this.heart);
    for (const socket of this.sockets.clients) socket.terminate();
    this.server.closeAllConnections();
    await new Promise((resolve) => this.server.close(resolve));
  }

  get clients() {
    return this.sockets.clients.size;
  }

  hello() {
    return {
      type: 'hello', version: '0.0.0-fake', now_s: this.now_s, needs_token: false, can_command: this.canCommand,
      simulator: this.simulator && { scenario: 'square', path: [[0, 0], [SIDE_M, 0], [SIDE_M, SIDE_M], [0, SIDE_M], [0, 0]], link_profiles: ['usb', 'bluetooth-spp'], ...this.simulator },
      fleet: this.fleet?.name ?? null,
      arena: this.arena,
      sources: this.sources.map((source) => ({ ...source, is_used: !this.switchedOff.includes(source.id) })),
      parameters: PARAMETERS.map((parameter) => ({ ...parameter })),
      robots: this.robots.map((id) => ({ id, name: this.names[id] ?? null })),
      recordings: this.recordings,
      history: { switched_off: this.switchedOff, simulator: this.simulator, ...this.history },
    };
  }

  /** Sends anything to all pages; text as it is. */
  send(message) {
    const text = typeof message === 'string' ? message : JSON.stringify(message);
    for (const socket of this.sockets.clients) socket.send(text);
  }

  /** Moves on by a number of frames of 20 ms and sends them. */
  advance(frames) {
    for (let sent = 0; sent < frames; sent += 1) {
      this.now_s += 0.02;
      this.send(this.frame());
    }
  }

  frame() {
    const t_s = this.now_s;
    const isSecond = Math.round(t_s / 0.02) % 50 === 0;
    return {
      type: 'frame', now_s: t_s,
      robots: this.robots.map((id, index) => this.#robot(id, t_s, index)),
      truth: this.simulator === null ? [] : this.robots.map((id, index) => ({ ...truthAt(t_s, placeOf(index)), ...(this.robots.length > 1 ? { robot: id } : {}) })),
      ...(isSecond ? { links: [LINK], clock: CLOCK, recording: { name: 'now.mcap', bytes: Math.round(4000 * t_s) }, switched_off: this.switchedOff, simulator: this.simulator } : {}),
      log: isSecond ? [{ t_s, severity: 6, text: `second ${Math.round(t_s)}` }] : [],
      dropped: 0,
    };
  }

  // Of a real robot nobody knows the truth; of it the station says where its wheels alone put it.
  #robot(id, t_s, index) {
    const part = { ...robotAt(id, t_s, placeOf(index)), ...(this.names[id] ? { name: this.names[id] } : {}) };
    if (this.simulator !== null) return part;
    const [x_m, y_m, heading_rad] = truthAt(t_s, placeOf(index)).odometry;
    return { ...part, scores: [], odometry: [{ t_s, x_m, y_m, heading_rad, is_relative: false }] };
  }

  /** Waits until the commands that came fulfil a condition, and gives the last one. */
  async until(holds) {
    // Only a test that fails waits so long.
    const signal = AbortSignal.timeout(20_000);
    while (!holds(this.commands)) await once(this.commanded, 'command', { signal });
    return this.commands.at(-1);
  }

  async #answer(request, response) {
    const { pathname } = new URL(request.url, this.address);
    if (request.method === 'POST') return this.#command(request, response);
    if (pathname.endsWith('/replay')) return reply(response, this.replay ? 200 : 404, this.replay ?? { error: 'no such recording' });
    if (pathname === '/v1/sources') return reply(response, 200, this.hello().sources);
    if (pathname === '/v1/fleet') return reply(response, this.fleet ? 200 : 404, this.fleet ?? { error: 'this station is in no fleet' });
    if (pathname === '/v1/recordings') return reply(response, 200, this.hello().recordings);
    const file = path.join(WEB, pathname === '/' ? 'index.html' : path.normalize(pathname));
    try {
      const bytes = await readFile(file);
      response.writeHead(200, { 'Content-Type': TYPES[path.extname(file)] ?? 'text/plain', 'Content-Security-Policy': "default-src 'self'" });
      response.end(bytes);
    } catch {
      reply(response, 404, { error: 'no such file' });
    }
  }

  async #command(request, response) {
    let text = '';
    for await (const part of request) text += part;
    this.commands.push(JSON.parse(text));
    this.commanded.emit('command');
    if (this.refusal) reply(response, 400, { error: this.refusal });
    else reply(response, 200, {});
  }
}

function reply(response, status, value) {
  response.writeHead(status, { 'Content-Type': 'application/json' });
  response.end(JSON.stringify(value));
}

/** A fleet of two stations: `ada` is served here, `bob` by the other one, `eve` by nobody, and `eva` has no estimate. */
export function fleetOf({ x_m = 0.5, age_s = 0.02 } = {}) {
  const estimate = (values) => ({
    epoch: 2, x_m, y_m: 0.5, heading_rad: 0.5, major_m: 0.02, heading_sigma_rad: 0.01, is_position_valid: true, is_heading_valid: true, is_dead_reckoning: false,
    age_s, transit_s: 0.0031, ...values,
  });
  const robot = (name, owner, values) => ({ name, owner, robot: null, estimate: estimate({}), received: 900, lost: 7, stale: 0, ...values });
  const [left, right] = [['left', true], ['right', false]].map(([name, is_this]) => ({ id: `${name}-0123456789abcdef`, name, is_this }));
  return {
    name: 'class',
    stations: [{ ...left, clock_offset_s: 0, clock_uncertainty_s: 0, robots: 1 }, { ...right, clock_offset_s: 12.5, clock_uncertainty_s: 0.0004, robots: 2 }],
    robots: [
      robot('ada', { ...left, epoch: 1 }, { robot: '0/1/1' }), robot('bob', { ...right, epoch: 2 }, { stale: 3 }), robot('eva', { ...right, epoch: 1 }, { estimate: null }),
      robot('eve', null, { estimate: estimate({ is_position_valid: false, is_heading_valid: false, transit_s: null }) }),
    ],
  };
}

// Four robots one behind the other on each square, squares in rows of four.
function placeOf(index) {
  const square = Math.floor(index / 4);
  return { ahead_s: 5 * (index % 4), east_m: 1.4 * (square % 4), north_m: 1.4 * Math.floor(square / 4) };
}

const FIRST_PLACE = placeOf(0);

// Round the square at constant speed, on the spot at the corners.
function truthAt(t_s, { ahead_s, east_m, north_m } = FIRST_PLACE) {
  const gone_m = (SPEED_M_PER_S * (t_s + ahead_s)) % (4 * SIDE_M);
  const side = Math.floor(gone_m / SIDE_M);
  const along_m = gone_m - side * SIDE_M;
  const [x, y] = [[along_m, 0], [SIDE_M, along_m], [SIDE_M - along_m, SIDE_M], [0, SIDE_M - along_m]][side];
  const heading_rad = Math.atan2(Math.sin((side * Math.PI) / 2), Math.cos((side * Math.PI) / 2));
  const drift_rad = 0.004 * t_s;
  const [sine, cosine] = [Math.sin(drift_rad), Math.cos(drift_rad)];
  const odometry = [east_m + 1.02 * (cosine * x - sine * y), north_m + 1.02 * (sine * x + cosine * y), heading_rad + drift_rad];
  return { t_s, robot_s: t_s, x_m: east_m + x, y_m: north_m + y, heading_rad, odometry };
}

function robotAt(id, t_s, place) {
  const truth = truthAt(t_s, place);
  const step = Math.round(t_s / 0.02);
  const wave = (rate) => Math.sin(rate * t_s) + 0.6 * Math.sin(2.7 * rate * t_s + 1);
  const estimate = {
    t_s, robot_s: t_s, x_m: truth.x_m + 0.002 * wave(1.1), y_m: truth.y_m + 0.002 * wave(1.7), heading_rad: truth.heading_rad + 0.004 * wave(0.7),
    major_m: 0.006 + 0.002 * Math.sin(t_s), minor_m: 0.004, axis_rad: 0.3 * t_s, heading_sigma_rad: 0.012,
    forward_m_per_s: SPEED_M_PER_S, turn_rad_per_s: 0, reset_counter: 0, is_dead_reckoning: false, fix_age_s: 0.1, is_relative: false, is_heading_known: true,
  };
  const off_m = ([x_m, y_m]) => Math.hypot(x_m - truth.x_m, y_m - truth.y_m);
  const score = { t_s, estimate_m: off_m([estimate.x_m, estimate.y_m]), odometry_m: off_m(truth.odometry), claim_m: estimate.major_m };
  const part = { id, estimates: [estimate], fixes: [], fusion: [], scores: [score] };
  part.fusion.push({ t_s, sensor: 'wheels', kind: 'wheel_angles', verdict: 'accepted', lag_s: 0, nis: wave(9.1) ** 2, dof: 1, innovation: [0.01 * wave(9.1)], sigma: [0.01] });
  if (step % 5 === 0) addFix(part, truth, t_s, step);
  if (step % 50 === 0) part.tallies = counted(t_s, step);
  if (step % 15 === 0) part.calibration = learned(t_s);
  return part;
}

function addFix(part, truth, t_s, step) {
  const verdict = step % 115 === 0 ? 'gated' : 'accepted';
  const off_m = verdict === 'gated' ? 0.2 : 0.006;
  const lag_s = step % 60 === 0 ? 0.5 : 0.1;
  part.fixes.push({ t_s, x_m: truth.x_m + off_m * Math.sin(7.3 * step), y_m: truth.y_m + off_m * Math.cos(3.1 * step), heading_rad: truth.heading_rad, sensor: 'camera', verdict, lag_s });
  part.fusion.push({
    t_s, sensor: 'camera', kind: 'fix', verdict, lag_s, nis: verdict === 'gated' ? 60 : 3 + 2.5 * Math.sin(5.3 * step), dof: 3,
    innovation: [off_m * Math.sin(7.3 * step), off_m * Math.cos(3.1 * step), 0.01 * Math.sin(step)], sigma: [0.007, 0.007, 0.015],
  });
}

// As if the station had run for a while before the page came.
function counted(t_s, step) {
  return [
    { t_s, sensor: 'wheels', kind: 'wheel_angles', seen: 7000 + step, gated: 0, late: 0 },
    { t_s, sensor: 'camera', kind: 'fix', seen: 1400 + Math.floor(step / 5), gated: 12 + Math.floor(step / 115), late: 5 },
  ];
}

function learned(t_s) {
  const shrunk = 1 / Math.sqrt(1 + t_s);
  return [
    { name: 'radius_scale', value: 0.005 * (1 - shrunk), sigma: 0.01 * shrunk, unit: '' },
    { name: 'gyro_bias_rad_per_s', value: 0.013 * (1 - shrunk), sigma: 0.035 * shrunk, unit: 'rad/s' },
  ];
}

const RECORDINGS = [
  { name: 'now.mcap', bytes: 0, begun: 1767229200, is_current: true },
  { name: 'square-1.mcap', bytes: 123456, begun: 1767225600, is_current: false },
];
const SOURCES = [{ id: 0, name: 'wheels', kind: 'wheels' }, { id: 1, name: 'gyro', kind: 'gyro' }, { id: 3, name: 'camera', kind: 'camera' }];
const PARAMETERS = [
  { name: 'gate_prob', value: 0.999, default: 0.999, least: 0.5, most: 0.999999, unit: '', help: 'a fix is used if its normalised innovation is below this quantile of chi-square', mavlink_name: 'gate_prob' },
  { name: 'slip_nis', value: 10.83, default: 10.83, least: 4, most: 100, unit: '', help: 'above this normalised innovation gyro and encoders disagree: the wheels slipped', mavlink_name: 'slip_nis' },
  { name: 'accel_m_s2', value: 1, default: 1, least: 0.01, most: 50, unit: 'm/s2', help: 'how fast the forward speed may change', mavlink_name: 'accel_m_s2' },
];
const LINK = {
  id: 0, name: 'pty:/dev/pts/4', state: 'up', bytes_in_per_s: 2310, frames_in_per_s: 51, lost: 3, kernel_drops: 0, flood_drops: 0, excess_requests: 0, checksum_errors: 1, garbage_bytes: 12, stalls: 0,
  queued_frames: 0, drops_out: 0, round_trip_ms: 1.4, clock_uncertainty_ms: 0.6,
};
const CLOCK = { offset_s: -1.2345, skew_ppm: 41.3, uncertainty_ms: 0.6, method: 'two-way' };
