// The fleet: every robot of all stations, who owns it and how old its estimate is here; commands go to the owner.

import { button, element, scrolled, setText } from '../view/dom.js';
import { age, count, degrees, fixed } from '../view/format.js';
import { PoseForm } from '../view/pose_form.js';
import { BY_EYE } from '../view/pose_input.js';

const COLUMNS = [['robot'], ['owner'], ['age', 'number'], ['on its way', 'number'], ['lost', 'number'], ['position'], ['heading', 'number'], ['commands']];

export const fleet = {
  id: 'fleet',
  title: 'Fleet',
  isShown: (view) => view.fleet !== null,
  build: (body, station) => new FleetPanel(body, station),
};

class FleetPanel {
  constructor(body, station) {
    this.station = station;
    this.rows = new Map();
    this.stations = element('p', { class: 'note' });
    this.more = element('p', { class: 'note', hidden: true });
    this.table = element('tbody');
    this.poseOf = null;
    this.poseTitle = element('h3');
    this.form = new PoseForm((pose) => this.#command({ command: 'set-pose', ...pose, ...BY_EYE }, this.poseOf));
    this.poseBox = element('div', { class: 'set-pose', hidden: true }, this.poseTitle, this.form.row);
    this.form.row.append(button('Cancel', () => this.#askPose(null)));
    body.append(this.stations, scrolled('Robots of the fleet', element('table', {},
      element('thead', {}, element('tr', {}, ...COLUMNS.map(([text, kind = '']) => element('th', { scope: 'col', class: kind, text })))),
      this.table)), this.more, this.poseBox);
  }

  draw({ fleet: known }) {
    if (known === null) return;
    setText(this.stations, `${known.name}: ${known.stations.map(stationText).join(', ')}`);
    const names = new Set(known.robots.map(({ name }) => name));
    for (const [name, row] of this.rows) {
      if (names.has(name)) continue;
      row.line.remove();
      this.rows.delete(name);
      if (this.poseOf === name) this.#askPose(null);
    }
    for (const robot of known.robots) this.#show(this.rows.get(robot.name) ?? this.#newRow(robot.name), robot, known);
    this.more.hidden = known.hidden === 0;
    setText(this.more, `${known.hidden} more robots are not shown`);
  }

  #newRow(name) {
    const cells = { owner: element('td', { class: 'owner' }), age: cell(), transit: cell(), lost: cell(), position: element('td', { class: 'position' }), heading: cell() };
    const reset = button('Reset pose', () => this.#command({ command: 'reset-pose' }, name), { 'aria-label': `Reset pose of ${name}` });
    const set = button('Set pose', () => this.#askPose(name), { 'aria-label': `Set pose of ${name}` });
    const buttons = element('td', { class: 'commands' }, reset, ' ', set);
    const line = element('tr', {}, element('th', { scope: 'row', class: 'name', text: name }), ...Object.values(cells), buttons);
    this.table.append(line);
    const row = { line, buttons: [reset, set], robot: null, ...cells };
    this.rows.set(name, row);
    return row;
  }

  #show(row, robot, known) {
    row.robot = robot;
    const { owner, estimate, lost, stale } = robot;
    setText(row.owner, owner ? `${String(owner.name).slice(0, 64)}${owner.is_this ? ' (this station)' : ''}` : 'nobody');
    const age_s = known.age_s(robot);
    setText(row.age, age_s < 1 ? fixed(1000 * age_s, 0, 'ms') : Number.isFinite(age_s) ? age(age_s) : '–');
    setText(row.transit, fixed(1000 * (estimate?.transit_s ?? NaN), 1, 'ms'));
    setText(row.lost, stale > 0 ? `${count(lost)}, ${count(stale)} of earlier owners` : count(lost));
    setText(row.position, positionText(estimate));
    setText(row.heading, estimate?.is_heading_valid ? degrees(estimate.heading_rad, 0) : '–');
    const state = known.isSilent(robot) ? 'silent' : 'live';
    if (row.line.dataset.state !== state) row.line.dataset.state = state;
    // A robot of this station has its controls in the other panels.
    const isHidden = !this.station.canCommand || !owner || owner.is_this;
    for (const one of row.buttons) if (one.hidden !== isHidden) one.hidden = isHidden;
  }

  #askPose(name) {
    this.poseOf = name;
    this.poseBox.hidden = name === null;
    if (name === null) return;
    setText(this.poseTitle, `Set the pose of ${name}`);
    this.form.fill(this.rows.get(name)?.robot.estimate);
    this.form.focus();
  }

  async #command(command, name) {
    const isTaken = await this.station.command({ ...command, fleet_robot: name });
    if (isTaken && command.command === 'set-pose' && this.poseOf === name) this.#askPose(null);
  }
}

function stationText({ name, is_this, clock_uncertainty_s, robots }) {
  const clock = is_this ? 'this station' : Number.isFinite(clock_uncertainty_s) ? `clock known to ${fixed(1000 * clock_uncertainty_s, 1, 'ms')}` : 'clock not known';
  return `${String(name).slice(0, 64)} (${clock}, ${count(robots)} ${robots === 1 ? 'robot' : 'robots'})`;
}

function positionText(estimate) {
  if (!estimate) return 'no estimate';
  if (!estimate.is_position_valid) return 'from its start';
  return `${fixed(estimate.x_m, 2)}, ${fixed(estimate.y_m, 2)} m`;
}

function cell() {
  return element('td', { class: 'number' });
}
