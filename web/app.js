// The page: stream in, session in the middle, panels out. One loop draws everything, with the screen.

import { Session } from './model/session.js';
import { timeAxis } from './model/time_axis.js';
import { silence_s } from './model/silence.js';
import { hasChoice } from './model/robot_list.js';
import { PANELS } from './panels/index.js';
import { Replay } from './replay.js';
import { Station } from './station.js';
import { Stream } from './stream.js';
import { element, setText } from './view/dom.js';
import { age } from './view/format.js';
import { headline } from './view/headline.js';
import { readPalette } from './view/palette.js';
import { followTheme } from './view/theme.js';
import { TimeBar } from './view/time_bar.js';

const NOTICE_MS = 6000;
// A station says something at least once a second.
const STALLED_FROM_S = 1.5;
// A clock that is known so badly says nothing about now.
const MOST_AHEAD_S = 1;
const CONNECTION_WORDS = {
  connecting: 'connecting',
  live: 'connected',
  stalled: 'the station says nothing',
  lost: 'connection lost, trying again',
  refused: 'the token holds no longer: open the address that the station prints now, or ask for a new token',
};

const page = {
  headline: document.getElementById('headline'),
  connection: document.getElementById('connection'),
  connectionAge: document.getElementById('connection-age'),
  silence: document.getElementById('silence'),
  announcer: document.getElementById('announcer'),
};

let session = new Session();
let connection = 'connecting';
let heard_ms = performance.now();
let shownRobot = null;
let isStale = true;
let turn = 0;
let noticeTimer = 0;

const station = new Station({
  announce, select, redraw: () => { isStale = true; }, replay: (name) => startReplay(name), isReplay: () => replay.isOn,
  robot: () => (replay.isOn ? null : chosenRobot(session)?.id ?? null),
});
const replay = new Replay(document.getElementById('replay-bar'), showMode);
const view = { session, isReplay: false, robot: null, isOneOfMany: false, errors: null, until_s: 0, silence_s: 0, stalled_s: 0, path: [], arena: null, fleet: null, hasSimulator: false };

const timeBar = new TimeBar(document.getElementById('time-bar'));
timeAxis.onChange = () => { isStale = true; };

readPalette();
const panels = PANELS.map(buildPanel);
followTheme(document.getElementById('theme'), () => {
  readPalette();
  for (const { panel } of panels) panel.recolour?.();
  isStale = true;
});
hideToken();
new Stream(streamAddress(), { onMessage: take, onState: (state) => { connection = state; isStale = true; } }).open();
requestAnimationFrame(frame);

function buildPanel({ id, title, isAnimated, isLive, isOfRobot, isShown, build }) {
  const body = element('div', { class: 'body' });
  const rest = element('p', { class: 'note', hidden: true });
  const of = element('span', { class: 'of' });
  const old = element('span', { class: 'old' });
  const heading = element('h2', { id: `${id}-title` }, title, of, old);
  const section = element('section', { class: 'panel', id, 'aria-labelledby': `${id}-title` }, heading, rest, body);
  document.getElementById('panels').append(section);
  const built = { section, body, rest, of, old, isShown, isOfRobot: Boolean(isOfRobot), isLive: Boolean(isLive), isAnimated: Boolean(isAnimated), isVisible: true, isDue: true, panel: build(body, station) };
  new IntersectionObserver((entries) => {
    built.isVisible = entries[entries.length - 1].isIntersecting;
    built.isDue = true;
    isStale = true;
  }).observe(section);
  return built;
}

function take(message) {
  heard_ms = performance.now();
  if (message.type === 'hello') {
    session = new Session();
    station.greet(message);
    showMode();
    session.apply(message.history);
    session.apply({ now_s: message.now_s });
  } else if (message.type === 'frame') {
    session.apply(message);
    station.apply(message);
  }
  isStale = true;
}

function frame(now_ms) {
  requestAnimationFrame(frame);
  if (replay.isOn) {
    replay.advance(now_ms);
    isStale = true;
  }
  // While nobody says anything all that is shown becomes older.
  if (isStale || stalled_s() > 0) {
    isStale = false;
    look();
    for (const built of panels) {
      built.isDue = true;
      if (built.isShown) built.section.hidden = !built.isShown(view);
      if (built.isOfRobot) showRobot(built);
      if (built.isAnimated && built.isVisible) draw(built);
    }
    showHeadline();
    timeBar.draw();
  }
  drawNext();
}

// Of which robot a panel is, and how old what it shows.
function showRobot({ section, of, old }) {
  const isOld = view.silence_s > 0;
  setText(of, view.isOneOfMany ? ` of ${view.robot.label}` : '');
  setText(old, isOld ? ` ${age(view.silence_s)} old` : '');
  if (section.classList.contains('stale') !== isOld) section.classList.toggle('stale', isOld);
}

// For how long the station has said nothing; 0 as long as that is as usual.
function stalled_s() {
  const stalled_s = (performance.now() - heard_ms) / 1000;
  return stalled_s >= STALLED_FROM_S ? stalled_s : 0;
}

// What the panels are shown: the live session or the replayed one, at its time.
function look() {
  view.isReplay = replay.isOn;
  view.session = replay.isOn ? replay.session : session;
  view.robot = chosenRobot(view.session);
  view.isOneOfMany = hasChoice(view.session);
  view.errors = view.robot ? view.session.errors.get(view.robot.id) : null;
  view.stalled_s = stalled_s();
  view.until_s = replay.isOn ? replay.until_s : liveTime();
  view.silence_s = silence_s(view.robot?.published, view.until_s);
  const { begin_s, now_s } = view.session;
  timeAxis.look(Number.isNaN(begin_s) ? view.until_s : begin_s, now_s, view.until_s);
  view.path = station.path();
  view.arena = station.arena;
  view.fleet = replay.isOn || station.fleet.name === null ? null : station.fleet;
  if (view.stalled_s === 0 && !document.hidden) view.fleet?.poll();
  view.hasSimulator = station.simulator !== null;
}

function chosenRobot(of) {
  const robots = of.estimated();
  return robots.find(({ id }) => id === shownRobot) ?? robots[0] ?? null;
}

// What acts on the robot before stops first.
function select(id) {
  if (chosenRobot(session)?.id !== id) for (const { panel } of panels) panel.rest?.();
  shownRobot = id;
  isStale = true;
}

// Now, or the instant of the latest estimate when the robot's clock has that a little later.
function liveTime() {
  const now_s = view.session.now_s + view.stalled_s;
  const published = view.robot?.published;
  if (!published || published.length === 0) return now_s;
  const last_s = published.columns.t_s[published.end - 1];
  return last_s > now_s && last_s < now_s + MOST_AHEAD_S ? last_s : now_s;
}

// The panels that are not animated come one a frame, in turn: no frame of the screen has to wait for all of them.
function drawNext() {
  for (let tried = 0; tried < panels.length; tried += 1) {
    turn = (turn + 1) % panels.length;
    const built = panels[turn];
    if (built.isAnimated || !built.isDue || !built.isVisible) continue;
    draw(built);
    return;
  }
}

function draw(built) {
  built.isDue = false;
  built.panel.draw(view);
}

function showHeadline() {
  setText(page.headline, headline(view));
  page.silence.hidden = view.silence_s === 0;
  if (view.silence_s > 0) setText(page.silence, `robot silent for ${Math.floor(view.silence_s)} s`);
  showConnection();
}

// Live or a recording: what acts on the live robot rests while another one is shown, and where this page may only look.
function showMode() {
  const isAtRest = replay.isOn || !station.canCommand;
  const why = replay.isOn ? 'These act on the live robot: go back to live to use them.' : 'Your token only lets you look.';
  for (const { isLive, body, rest, panel } of panels) {
    if (!isLive) continue;
    body.inert = isAtRest;
    rest.hidden = !isAtRest;
    setText(rest, isAtRest ? why : '');
    if (isAtRest) panel.rest?.();
  }
  isStale = true;
}

// The age stands apart: what is read aloud on every change shall not change every second.
function showConnection() {
  const state = connection === 'live' && view.stalled_s > 0 ? 'stalled' : connection;
  if (page.connection.dataset.state !== state) page.connection.dataset.state = state;
  setText(page.connection, CONNECTION_WORDS[state]);
  const isOld = state !== 'live' && view.stalled_s > 0;
  setText(page.connectionAge, isOld && station.isGreeted ? `last heard ${Math.floor(view.stalled_s)} s ago` : '');
}

async function startReplay(name) {
  announce(`Reading ${name}…`, false);
  const history = await station.history(name);
  if (!history) return;
  if (replay.begin(name, history)) announce(`Replay of ${name}`, false);
  else announce(`${name} holds no estimate.`, true);
  showMode();
}

function announce(text, isError) {
  clearTimeout(noticeTimer);
  setText(page.announcer, text);
  page.announcer.className = isError ? 'notice error' : 'notice';
  noticeTimer = setTimeout(() => {
    page.announcer.className = 'unseen';
  }, NOTICE_MS);
}

function streamAddress() {
  const address = new URL('v1/stream', location.href);
  address.protocol = address.protocol === 'https:' ? 'wss:' : 'ws:';
  address.search = '';
  address.hash = '';
  return address.href;
}

// The token is in a cookie by now; the address that people copy and photograph shall not hold it.
function hideToken() {
  if (location.search.includes('token=')) history.replaceState(null, '', location.pathname);
}
