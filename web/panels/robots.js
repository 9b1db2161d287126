// All robots that are heard: how each is, and which one the other panels show.

import { hasChoice, robotRows } from '../model/robot_list.js';
import { element, scrolled, setText } from '../view/dom.js';
import { fixed, millimetres } from '../view/format.js';

const COLUMNS = [['robot'], ['state'], ['last fix', 'number'], ['95 % within', 'number'], ['resets', 'number']];

const STATES = new Map([
  ['waiting', () => 'no estimate'],
  ['live', (row, isReplay) => (isReplay ? 'heard' : 'live')],
  ['silent', (row) => `silent for ${Math.floor(row.silent_s)} s`],
  ['lost', (row) => (row.silent_s > 0 ? `lost for ${Math.floor(row.silent_s)} s` : 'lost')],
]);

export const robots = {
  id: 'robots',
  title: 'Robots',
  isShown: (view) => hasChoice(view.session),
  build: (body, station) => new RobotsPanel(body, station),
};

class RobotsPanel {
  constructor(body, station) {
    this.station = station;
    this.rows = new Map();
    this.table = element('tbody');
    body.append(scrolled('List of robots', element('table', {},
      element('thead', {}, element('tr', {}, ...COLUMNS.map(([text, kind = '']) => element('th', { scope: 'col', class: kind, text })))),
      this.table)));
  }

  draw(view) {
    const known = robotRows(view.session, view.until_s);
    const ids = new Set(known.map(({ id }) => id));
    for (const [id, row] of this.rows) {
      if (ids.has(id)) continue;
      row.line.remove();
      this.rows.delete(id);
    }
    for (const robot of known) {
      const row = this.rows.get(robot.id) ?? this.#newRow(robot.id);
      show(row, robot, view.isReplay);
      this.#mark(row, robot.id === view.robot?.id);
    }
  }

  // One group of radio buttons: one stop of the tab key, arrows go from robot to robot. The row is as good as its button.
  #newRow(id) {
    const choose = () => this.station.select(id);
    const radio = element('input', { type: 'radio', name: 'robot', value: id, on: { change: choose, keydown: (event) => { if (event.key === 'Enter') choose(); } } });
    const name = element('span', { class: 'robot-name' });
    const address = element('span', { class: 'robot-id' });
    const cells = { state: element('td', { class: 'robot-state' }), fix: cell(), sigma: cell(), resets: cell() };
    const line = element('tr', { on: { click: choose } },
      element('th', { scope: 'row' }, element('label', {}, radio, name, ' ', address)), cells.state, cells.fix, cells.sigma, cells.resets);
    this.table.append(line);
    const row = { line, radio, name, address, isChosen: null, ...cells };
    this.rows.set(id, row);
    return row;
  }

  #mark(row, isChosen) {
    if (row.radio.checked !== isChosen) row.radio.checked = isChosen;
    if (row.isChosen === isChosen) return;
    row.isChosen = isChosen;
    row.line.classList.toggle('chosen', isChosen);
    if (isChosen) keepInSight(row.line);
  }
}

function show(row, robot, isReplay) {
  setText(row.name, robot.name || robot.id);
  setText(row.address, robot.name ? robot.id : '');
  setText(row.state, STATES.get(robot.state)(robot, isReplay));
  if (row.line.dataset.state !== robot.state) row.line.dataset.state = robot.state;
  setText(row.fix, fixed(robot.fixAge_s, 1, 's'));
  setText(row.sigma, millimetres(robot.sigma_m));
  setText(row.resets, fixed(robot.resets, 0));
}

// Scrolls the list and not the page.
function keepInSight(line) {
  const box = line.closest('.scroll');
  const head = box.querySelector('thead').offsetHeight;
  const [top, bottom] = [line.offsetTop - head, line.offsetTop + line.offsetHeight];
  if (top < box.scrollTop) box.scrollTop = top;
  else if (bottom > box.scrollTop + box.clientHeight) box.scrollTop = bottom - box.clientHeight;
}

function cell() {
  return element('td', { class: 'number' });
}
