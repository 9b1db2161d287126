// The arena from above: truth, brick odometry and estimate of the chosen robot with their trails, ellipse and heading cone, what the camera saw, and
// where the other robots are, also those that other stations of the fleet own.

import { MARKS, MARK_WORDS } from '../model/marks.js';
import { ESTIMATE_COLUMNS } from '../model/robot.js';
import { comparableRow, readTruth } from '../model/same_instant.js';
import { drawArena, drawBeacon, drawCone, drawEllipse, drawFixes, drawGrid, drawLandmark, drawMark, drawPath, drawRobot, drawTrail, drawWall } from '../view/arena_scene.js';
import { Box, Camera } from '../view/camera.js';
import { button, element, setText } from '../view/dom.js';
import { FleetRobots } from '../view/fleet_robots.js';
import { degrees, fixed, metres, millimetres } from '../view/format.js';
import { Lens, lensSize_px } from '../view/lens.js';
import { listen } from '../view/map_input.js';
import { OtherRobots } from '../view/other_robots.js';
import { ComparedColours, DASHES, palette } from '../view/palette.js';
import { PoseForm } from '../view/pose_form.js';
import { BY_EYE, PoseInput } from '../view/pose_input.js';

const TRAIL_S = 60;
const ZOOM_STEP = 1.25;
// Height of the toolbar on the map, with the space around it.
const TOOLBAR_PX = 34;
// An estimate that nobody renews fades.
const STALE_ALPHA = 0.35;

const READINGS = [
  ['reference', 'relative to'], ['x', 'x'], ['y', 'y'], ['heading', 'heading'], ['sigma', '95 % within'], ['speed', 'speed'], ['fix', 'last fix'], ['resets', 'resets'], ['age', 'estimate'],
];

const ESTIMATE = ESTIMATE_COLUMNS.map((name) => [name, name]);
const TRUTH = ['x_m', 'y_m', 'heading_rad'];
const ODOMETRY = TRUTH.map((name) => `odometry_${name}`);
const OWN_ODOMETRY = TRUTH.map((name) => [name, name]);
const STANDING = [['walls', 'wall', drawWall], ['landmarks', 'landmark', drawLandmark], ['beacons', 'beacon', drawBeacon]];

export const arena = {
  id: 'arena',
  title: 'Arena',
  isAnimated: true,
  isShown: (view) => !view.session.hasOnlyQuantities(),
  build: (body, station) => new ArenaPanel(body, station),
};

class ArenaPanel {
  constructor(body, station) {
    this.station = station;
    this.camera = new Camera();
    this.lens = new Lens();
    this.box = new Box();
    this.others = new OtherRobots();
    this.fleet = new FleetRobots();
    this.pose = pose();
    this.truth = pose();
    this.odometry = pose();
    this.mode = 'fit';
    this.session = null;
    this.robot = null;
    this.known = null;
    this.trails = [];
    this.kept = { right_px: 0, top_px: 0 };
    this.canvas = element('canvas', { tabindex: '0', role: 'img', 'aria-label': 'Map of the arena. Arrow keys move it, plus and minus zoom.' });
    this.context = this.canvas.getContext('2d');
    this.fitButton = button('Fit', () => this.#look('fit'), { 'aria-pressed': 'true', title: 'Show the whole drive (0)' });
    this.followButton = button('Follow', () => this.#look('follow'), { 'aria-pressed': 'false', title: 'Keep the estimate in the middle (F)' });
    this.lensButton = button('Lens', () => this.#toggleLens(), { 'aria-pressed': 'true', title: 'A close look at the estimate' });
    this.poseButton = button('Set pose', () => this.#togglePoseInput(), { 'aria-pressed': 'false', title: 'Press where the robot is, drag to where it looks' });
    this.readings = new Map(READINGS.map(([key]) => [key, element('dd')]));
    this.output = element('dl', { class: 'readings', id: 'pose', 'aria-label': 'Latest estimate' },
      ...READINGS.map(([key, label]) => element('div', {}, element('dt', { text: label }), this.readings.get(key))));
    body.append(
      element('div', { class: 'map' }, this.canvas, this.#toolbar()),
      this.output,
      this.#poseFields(),
      this.#legend(),
    );
    this.poseInput = new PoseInput(this.canvas, this.camera, {
      onPose: (pose) => this.#setPose(pose),
      onMove: () => station.redraw(),
      onEnd: () => {
        this.poseButton.setAttribute('aria-pressed', 'false');
        station.redraw();
      },
    });
    listen(this.canvas, this.camera, () => this.#look('free'), (x_px, y_px) => this.#click(x_px, y_px));
    this.canvas.addEventListener('pointermove', (event) => this.#hover(event));
    this.canvas.addEventListener('keydown', (event) => this.#key(event));
    new ResizeObserver(() => this.#fitCanvas()).observe(this.canvas);
  }

  draw(view) {
    this.#read(view);
    this.#aim(view);
    this.#paint(view);
    this.#say(view);
  }

  #toolbar() {
    return element('div', { class: 'toolbar', role: 'toolbar', 'aria-label': 'Map' },
      this.fitButton, this.followButton, this.lensButton, this.poseButton,
      button('+', () => this.#zoom(ZOOM_STEP), { 'aria-label': 'Zoom in' }),
      button('−', () => this.#zoom(1 / ZOOM_STEP), { 'aria-label': 'Zoom out' }));
  }

  // For those who do not drag: the same in numbers.
  #poseFields() {
    const form = new PoseForm((pose) => this.#setPose(pose));
    return element('details', { class: 'set-pose' }, element('summary', { text: 'Set the pose in numbers' }), form.row);
  }

  #togglePoseInput() {
    if (this.poseInput.isAsking) {
      this.poseInput.stop();
      return;
    }
    this.poseInput.start();
    this.poseButton.setAttribute('aria-pressed', 'true');
  }

  #setPose(pose) {
    this.station.commandRobot({ command: 'set-pose', ...pose, ...BY_EYE });
  }

  #legend() {
    const lines = [['truth', 'truth'], ['odometry', 'odometry'], ['estimate', 'estimate, 95 % ellipse, heading cone']];
    this.swatches = lines.map(([name, text]) => {
      const canvas = swatch();
      return { name, canvas, item: element('li', {}, canvas, text) };
    });
    this.markSwatches = [MARKS.accepted, MARKS.late, MARKS.gated, MARKS.tooOld, MARKS.resetTo].map((mark) => ({ mark, canvas: swatch(16) }));
    this.standingSwatches = STANDING.map(([name, text, draw]) => {
      const canvas = swatch(24);
      return { name, draw, canvas, item: element('li', {}, canvas, text) };
    });
    this.legend = element('ul', { class: 'legend', 'aria-label': 'Legend' },
      ...this.swatches.map(({ item }) => item), ...this.standingSwatches.map(({ item }) => item),
      ...this.markSwatches.map(({ mark, canvas }) => element('li', {}, canvas, `fix ${MARK_WORDS[mark]}`)));
    return this.legend;
  }

  /** Draws what depends on colours only. */
  recolour() {
    for (const { name, canvas } of this.swatches) {
      const context = sharp(canvas);
      context.strokeStyle = palette[name];
      context.lineWidth = 2.5;
      context.setLineDash(DASHES[name]);
      context.beginPath();
      context.moveTo(0, 6);
      context.lineTo(30, 6);
      context.stroke();
    }
    for (const { draw, canvas } of this.standingSwatches) draw(sharp(canvas), 12, 6);
    for (const { mark, canvas } of this.markSwatches) drawMark(sharp(canvas), mark, 8, 6, 4.2);
  }

  #zoom(factor) {
    this.camera.zoom(factor);
    this.#look(this.mode === 'follow' ? 'follow' : 'free');
  }

  #look(mode) {
    this.mode = mode;
    this.fitButton.setAttribute('aria-pressed', String(mode === 'fit'));
    this.followButton.setAttribute('aria-pressed', String(mode === 'follow'));
    this.station.redraw();
  }

  #toggleLens() {
    this.lensButton.setAttribute('aria-pressed', String(!this.#hasLens()));
    this.station.redraw();
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === '0') this.#look('fit');
    if (event.key === 'f' || event.key === 'F') this.#look('follow');
  }

  #click(x_px, y_px) {
    const robot = this.others.at(this.camera, x_px, y_px);
    if (robot) this.station.select(robot.id);
  }

  #hover(event) {
    const robot = event.buttons === 0 && this.others.count > 1 ? this.others.at(this.camera, event.offsetX, event.offsetY) : null;
    this.canvas.classList.toggle('on-robot', robot !== null);
    const title = robot ? robot.label : '';
    if (this.canvas.title !== title) this.canvas.title = title;
  }

  #fitCanvas() {
    const scale = globalThis.devicePixelRatio || 1;
    this.camera.width_px = this.canvas.clientWidth;
    this.camera.height_px = this.canvas.clientHeight;
    this.canvas.width = Math.round(this.camera.width_px * scale);
    this.canvas.height = Math.round(this.camera.height_px * scale);
    this.context.setTransform(scale, 0, 0, scale, 0, 0);
    this.recolour();
    this.station.redraw();
  }

  // The poses at the time that is shown.
  #read(view) {
    const truth = view.session.truthOf(view.robot);
    const compared = view.robot?.compared.size ?? 0;
    if (this.session !== view.session || this.robot !== view.robot || this.known !== truth || this.compared !== compared) {
      this.compared = compared;
      this.session = view.session;
      this.robot = view.robot;
      this.known = truth;
      this.trails = trails(view, truth);
    }
    const own = view.robot?.odometry;
    const has = { estimate: true, truth: Boolean(truth), odometry: Boolean(truth) || own?.length > 0 };
    for (const { name, item } of this.swatches) if (item.hidden === has[name]) item.hidden = !has[name];
    for (const { name, item } of this.standingSwatches) item.hidden = view.arena[name].length === 0;
    this.others.read(view.session, view.robot, view.until_s);
    this.fleet.read(view);
    const estimates = view.robot?.estimates;
    const row = !estimates ? -1 : truth ? comparableRow(estimates, truth, view.until_s) : estimates.rowUntil(view.until_s);
    this.pose.has = readRow(this.pose, estimates, row, ESTIMATE);
    // Without an estimate, or with an old one, the truth is that of now.
    const isNow = this.pose.has && view.silence_s === 0;
    const robot_s = isNow ? this.pose.robot_s : truth?.columns.robot_s[truth.rowUntil(view.until_s)];
    this.truth.has = Boolean(truth) && readTruth(this.truth, truth, view.until_s, robot_s, TRUTH);
    this.odometry.has = truth
      ? readTruth(this.odometry, truth, view.until_s, robot_s, ODOMETRY)
      : readRow(this.odometry, own, own?.rowUntil(view.until_s) ?? -1, OWN_ODOMETRY);
  }

  #aim(view) {
    if (this.mode === 'follow' && this.pose.has) {
      this.camera.x_m = this.pose.x_m;
      this.camera.y_m = this.pose.y_m;
    }
    if (this.mode !== 'fit') return;
    this.box.clear();
    for (const [x_m, y_m] of view.path) this.box.add(x_m, y_m);
    if (this.#isInArena()) addArena(this.box, view.arena);
    for (const trail of this.trails) {
      const [from, to] = rows(trail.track, view);
      const step = Math.max(1, Math.floor((to - from) / 200));
      for (let row = from; row < to; row += step) this.box.add(trail.track.columns[trail.x][row], trail.track.columns[trail.y][row]);
    }
    for (const shown of [this.pose, this.truth, this.odometry]) if (shown.has) this.box.add(shown.x_m, shown.y_m);
    this.others.addTo(this.box);
    if (this.#isInArena()) this.fleet.addTo(this.box);
    if (this.box.isEmpty) this.box.add(0, 0);
    this.camera.fit(this.box, this.#kept());
  }

  // What the drive shall not stand under: the toolbar, and the lens, at the right of a broad map and at the top of a narrow one.
  #kept() {
    const size_px = this.#hasLens() ? lensSize_px(this.camera) : 0;
    const isBroad = this.camera.width_px - size_px > this.camera.height_px - TOOLBAR_PX;
    this.kept.right_px = isBroad ? size_px : 0;
    this.kept.top_px = isBroad ? TOOLBAR_PX : Math.max(TOOLBAR_PX, size_px);
    return this.kept;
  }

  #hasLens() {
    return this.lensButton.getAttribute('aria-pressed') === 'true';
  }

  #paint(view) {
    const { context, camera } = this;
    context.clearRect(0, 0, camera.width_px, camera.height_px);
    drawGrid(context, camera);
    drawPath(context, camera, view.path);
    if (this.#isInArena()) drawArena(context, camera, view.arena);
    if (this.#isInArena()) this.fleet.draw(context, camera);
    this.others.draw(context, camera);
    for (const trail of this.trails) if (this.#isOnMap(trail, view)) drawTrail(context, camera, trail, ...rows(trail.track, view));
    if (view.robot) drawFixes(context, camera, view.robot.fixes, view.until_s);
    if (this.odometry.has) drawRobot(context, camera, this.odometry, { colour: 'odometry', width: 1.5, dash: DASHES.odometry });
    if (this.truth.has) drawRobot(context, camera, this.truth, { colour: 'truth', width: 1.5 });
    this.#paintEstimate(view);
    this.others.drawChosenName(context);
    this.poseInput.draw(context);
    if (this.pose.has && this.#hasLens()) {
      this.lens.draw(context, camera, { estimate: this.pose, truth: this.truth.has && this.pose.is_relative !== 1 ? this.truth : null, fixes: view.robot.fixes, until_s: view.until_s, alpha: view.silence_s > 0 ? STALE_ALPHA : 1 });
    }
  }

  // What stands in the arena says nothing of a pose that counts from the robot's start.
  #isInArena() {
    return !this.pose.has || this.pose.is_relative !== 1;
  }

  // A filter that has not found the robot yet counts from elsewhere.
  #isOnMap({ track }, view) {
    const row = track.columns.is_relative ? track.rowUntil(view.until_s) : -1;
    return row < 0 || !this.pose.has || Object.is(track.columns.is_relative[row], this.pose.is_relative);
  }

  #paintEstimate(view) {
    if (!this.pose.has) return;
    const { context, camera } = this;
    const isStale = view.silence_s > 0;
    if (isStale) context.globalAlpha = STALE_ALPHA;
    drawEllipse(context, camera, this.pose);
    drawCone(context, camera, this.pose);
    context.globalAlpha = 1;
    drawRobot(context, camera, this.pose, isStale ? { colour: 'old', width: 2 } : { colour: 'estimate', width: 2, isFilled: true });
  }

  #say(view) {
    const estimate = this.pose;
    const shown = this.readings;
    const known = (text) => (estimate.has ? text : '–');
    // An estimate tells how old its fix was then; it has become older with it.
    const fixAge = fixed(estimate.fix_age_s + Math.max(0, view.until_s - estimate.t_s), 1, 's');
    this.output.classList.toggle('stale', view.silence_s > 0);
    setText(shown.get('reference'), known(estimate.is_relative ? 'its start' : 'the arena'));
    setText(shown.get('x'), known(metres3(estimate.x_m)));
    setText(shown.get('y'), known(metres3(estimate.y_m)));
    setText(shown.get('heading'), known(estimate.is_heading_known ? degrees(estimate.heading_rad) : 'unknown'));
    setText(shown.get('sigma'), known(millimetres(estimate.major_m)));
    setText(shown.get('speed'), known(fixed(estimate.forward_m_per_s, 2, 'm/s')));
    setText(shown.get('fix'), known(fixText(estimate, fixAge)));
    setText(shown.get('age'), view.silence_s > 0 ? `${fixed(view.silence_s, 1, 's')} old` : known(view.isReplay ? 'of this time' : 'now'));
    setText(shown.get('resets'), known(fixed(estimate.reset_counter, 0)));
    const data = this.output.dataset;
    data.robot = view.robot?.id ?? '';
    if (!estimate.has) return;
    data.t_s = estimate.t_s;
    data.x_m = estimate.x_m;
    data.y_m = estimate.y_m;
    data.heading_rad = estimate.heading_rad;
    data.major_m = estimate.major_m;
    data.reset_counter = estimate.reset_counter;
    data.is_relative = estimate.is_relative;
    data.minor_m = estimate.minor_m;
    data.axis_rad = estimate.axis_rad;
    if (!this.truth.has) return;
    data.truth_x_m = this.truth.x_m;
    data.truth_y_m = this.truth.y_m;
  }
}

function addArena(box, { landmarks, beacons, walls }) {
  for (const { x_m, y_m } of [...landmarks, ...beacons]) box.add(x_m, y_m);
  for (const [x_m, y_m] of walls.flat()) box.add(x_m, y_m);
}

function fixText(estimate, age) {
  if (!Number.isFinite(estimate.fix_age_s)) return 'none yet';
  return estimate.is_dead_reckoning ? `none for ${age}` : age;
}

function metres3(value_m) {
  return Number.isFinite(value_m) ? `${value_m.toFixed(3)} m` : metres(value_m);
}

function pose() {
  return { has: false, t_s: NaN, x_m: NaN, y_m: NaN, heading_rad: NaN };
}

// Fills a pose from a track's row: pairs of the pose's and the track's names.
function readRow(into, track, row, names) {
  if (row < 0) return false;
  into.t_s = track.columns.t_s[row];
  for (const [name, column] of names) into[name] = track.columns[column][row];
  return !Number.isNaN(into.x_m + into.y_m);
}

function trails(view, truth) {
  const shown = [];
  if (truth) {
    shown.push({ track: truth, x: 'x_m', y: 'y_m', colour: 'truth', width: 3 });
    shown.push({ track: truth, x: 'odometry_x_m', y: 'odometry_y_m', colour: 'odometry', width: 1.8 });
  } else if (view.robot) {
    shown.push({ track: view.robot.odometry, x: 'x_m', y: 'y_m', colour: 'odometry', width: 1.8 });
  }
  for (const [filter, track] of view.robot?.compared ?? []) {
    shown.push({ track, x: 'x_m', y: 'y_m', stroke: ComparedColours.of(view.robot, filter), dash: ComparedColours.dash(view.robot, filter), width: 1.2 });
  }
  if (view.robot) shown.push({ track: view.robot.estimates, x: 'x_m', y: 'y_m', colour: 'estimate', width: 1.6 });
  return shown;
}

// Rows of the last while; where the robot was found in the arena, what came before counts from elsewhere.
function rows(track, view) {
  const [from, to] = [track.rowAt(view.until_s - TRAIL_S), track.rowAfter(view.until_s)];
  return [track.columns.is_relative ? track.sameFrom('is_relative', from, to) : from, to];
}

function swatch(width = 30) {
  const canvas = element('canvas', { class: 'swatch', 'aria-hidden': 'true' });
  canvas.dataset.width = width;
  canvas.classList.toggle('narrow', width < 30);
  return canvas;
}

function sharp(canvas) {
  const scale = globalThis.devicePixelRatio || 1;
  canvas.width = Number(canvas.dataset.width) * scale;
  canvas.height = 12 * scale;
  const context = canvas.getContext('2d');
  context.scale(scale, scale);
  return context;
}
