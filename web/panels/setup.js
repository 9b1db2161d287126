// What is left to do until a robot is set up: stands first until every step is complete.

import { element, setText } from '../view/dom.js';

const COMPLETE = new Set(['ok', 'optional']);

export const setup = {
  id: 'setup',
  title: 'Set up the robot',
  isOfRobot: true,
  // A simulated robot is set up, and a recording is over.
  isShown: (view) => !view.isReplay && !view.hasSimulator && steps(view).some((step) => !COMPLETE.has(step.state)),
  build(body) {
    const list = element('ol', { class: 'setup' });
    const lines = new Map();
    body.append(list);
    return {
      draw(view) {
        // The map below shall not move while somebody drags on it.
        if (document.querySelector('#arena:active')) return;
        for (const step of steps(view)) {
          const line = lines.get(step.step) ?? newLine(step.step, list, lines);
          line.item.dataset.state = step.state;
          setText(line.state, step.state);
          setText(line.figure, step.figure);
          setText(line.advice, step.advice);
        }
      },
    };
  },
};

// Of the chosen robot, or of the one that is not heard yet.
function steps(view) {
  const { setup: rows } = view.session;
  const own = rows.filter((row) => row.robot === view.robot?.id);
  return own.length > 0 ? own : rows.filter((row) => row.robot === '');
}

function newLine(step, list, lines) {
  const line = { state: element('span', { class: 'state' }), figure: element('span', { class: 'figure' }), advice: element('p', { class: 'advice' }) };
  line.item = element('li', {}, element('span', { class: 'step', text: step }), line.state, line.figure, line.advice);
  list.append(line.item);
  lines.set(step, line);
  return line;
}
