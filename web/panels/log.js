// What happened, newest first.

import { element } from '../view/dom.js';
import { clockTime } from '../view/format.js';

const MOST_LINES = 200;

export const log = {
  id: 'log',
  title: 'Events',
  build(body) {
    const lines = element('ol');
    const host = element('div', { class: 'log', role: 'log', 'aria-live': 'off', tabindex: '0', 'aria-label': 'Events, newest first' }, lines);
    const empty = element('p', { class: 'note', text: 'Nothing has happened yet.' });
    let shown = 0;
    let session = null;
    body.append(empty, host);
    return {
      draw(view) {
        if (view.session !== session) {
          session = view.session;
          shown = 0;
          lines.replaceChildren();
        }
        // Of a recording the lines up to the time that is shown.
        const until = view.isReplay ? session.loggedUntil(view.until_s) : session.logged;
        if (until < shown) {
          shown = 0;
          lines.replaceChildren();
        }
        const last = until - (session.logged - session.log.length);
        const fresh = Math.min(until - shown, last, MOST_LINES);
        shown = until;
        for (const entry of session.log.slice(last - fresh, last)) lines.prepend(line(entry));
        while (lines.childElementCount > MOST_LINES) lines.lastElementChild.remove();
        empty.hidden = lines.childElementCount > 0;
      },
    };
  },
};

function line(entry) {
  return element('li', { 'data-severity': entry.severity },
    element('time', { text: clockTime(entry.t_s) }),
    element('span', { class: 'severity', text: entry.severity }),
    element('span', { class: 'text', text: entry.text }));
}
