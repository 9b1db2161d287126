// Filters side by side: whether they run, and of each its error, its claim and its NIS. Their paths are drawn on the map.

import { ComparedColours } from '../view/palette.js';
import { element, scrolled, setText } from '../view/dom.js';
import { fixed, millimetres } from '../view/format.js';

const COLUMNS = [
  ['filter', 'its estimates; the first one sends'], ['error', 'distance from the truth now'], ['rms', 'root mean square of the error since the comparison began'],
  ['apart', 'distance from the filter that sends'], ['95 % within', 'half the longer axis of its ellipse'], ['NIS/dof', '1 is consistent, more is too sure'],
  ['used', 'observations that it used'], ['gated', 'observations that it refused'],
];

export const comparison = {
  id: 'comparison',
  title: 'Filters compared',
  isOfRobot: true,
  isShown: (view) => !view.session.hasOnlyQuantities(),
  build: (body, station) => new ComparisonPanel(body, station),
};

class ComparisonPanel {
  constructor(body, station) {
    this.station = station;
    this.rows = new Map();
    this.isComparing = null;
    this.box = element('input', { type: 'checkbox', on: { change: () => station.command({ command: 'compare-filters', on: this.box.checked }) } });
    this.table = element('tbody');
    this.ended = element('p', { class: 'note', text: 'As at the end of the recording.', hidden: true });
    this.host = scrolled('Compared filters', element('table', {},
      element('thead', {}, element('tr', {}, ...COLUMNS.map(([text, title], index) => element('th', { scope: 'col', class: index > 0 && 'number', text, title })))),
      this.table));
    this.host.hidden = true;
    body.append(
      element('label', { class: 'hand' }, this.box, ' Run further filters beside the one that sends'),
      this.ended, this.host);
  }

  draw(view) {
    // The box shows what the station says, and in between what was asked for.
    if (this.isComparing !== this.station.isComparing) {
      this.isComparing = this.station.isComparing;
      this.box.checked = this.isComparing;
    }
    const known = view.robot?.comparison ?? [];
    this.host.hidden = known.length === 0;
    this.ended.hidden = !view.isReplay || known.length === 0;
    const names = new Set(known.map(({ filter }) => filter));
    for (const [name, row] of this.rows) {
      if (names.has(name)) continue;
      row.line.remove();
      this.rows.delete(name);
    }
    for (const filter of known) {
      const row = this.rows.get(filter.filter) ?? this.#newRow(filter.filter, view.robot);
      show(row, filter);
    }
  }

  #newRow(name, robot) {
    const key = element('span', { class: 'key filter' });
    key.style.setProperty('--line', name ? ComparedColours.of(robot, name) : 'var(--estimate)');
    key.style.setProperty('--dash', name && ComparedColours.dash(robot, name).length > 0 ? 'dashed' : 'solid');
    const cells = COLUMNS.slice(1).map(() => element('td', { class: 'number' }));
    const line = element('tr', {}, element('th', { scope: 'row' }, key, name || 'sent'), ...cells);
    this.table.append(line);
    const row = { line, cells };
    this.rows.set(name, row);
    return row;
  }
}

function show({ cells }, filter) {
  const texts = [
    millimetres(filter.error_m), millimetres(filter.error_rms_m), filter.filter ? millimetres(filter.apart_m) : '', millimetres(filter.major_m),
    fixed(filter.nis, 2), fixed(filter.used, 0), fixed(filter.gated, 0),
  ];
  texts.forEach((text, index) => setText(cells[index], text));
}
