// The bar at the bottom of the page. Says which span of time the charts show, and at which instant somebody points; buttons for those who do not drag.

import { timeAxis } from '../model/time_axis.js';
import { button, element, setText } from './dom.js';
import { clockTime, shortTime } from './format.js';

export class TimeBar {
  constructor(host) {
    this.text = element('span', { class: 'number', id: 'time-span' });
    this.cursor = element('span', { class: 'number', id: 'time-cursor' });
    this.buttons = [['minute', 'Last minute'], ['run', 'Whole run']].map(([base, text]) => ({ base, node: button(text, () => timeAxis.show(base), { 'aria-pressed': 'false' }) }));
    host.append(this.text, this.cursor, element('span', { class: 'actions', role: 'group', 'aria-label': 'Span of the charts' }, ...this.buttons.map(({ node }) => node)));
  }

  draw() {
    const { base, isZoomed, cursor_s, span } = timeAxis;
    const ends = `${shortTime(span.from_s)} to ${shortTime(span.to_s)}`;
    setText(this.text, isZoomed ? `Charts: ${ends}, double-click shows more` : base === 'run' ? `Charts: whole run, ${ends}` : 'Charts: last 60 s');
    setText(this.cursor, Number.isNaN(cursor_s) ? '' : `at ${clockTime(cursor_s)}`);
    for (const { base: of, node } of this.buttons) {
      const isPressed = String(!isZoomed && of === base);
      if (node.getAttribute('aria-pressed') !== isPressed) node.setAttribute('aria-pressed', isPressed);
    }
  }
}
