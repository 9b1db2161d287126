// Health of every link, and how well the robot's clock is known.

import { staleness_s } from '../model/silence.js';
import { element, setText } from '../view/dom.js';
import { age, bytes, count, fixed } from '../view/format.js';

const FACTS = [
  ['in', (link) => `${bytes(link.bytes_in_per_s)}/s, ${fixed(link.frames_in_per_s, 0)} frames/s`],
  ['lost', losses],
  ['checksum errors', (link) => count(link.checksum_errors)],
  ['garbage', (link) => bytes(link.garbage_bytes)],
  ['stalls', (link) => count(link.stalls)],
  ['waiting to go out', (link) => count(link.queued_frames)],
  ['dropped on the way out', (link) => count(link.drops_out)],
  ['round trip', (link) => fixed(link.round_trip_ms ?? NaN, 1, 'ms')],
  ['clock known to', (link) => fixed(link.clock_uncertainty_ms ?? NaN, 2, 'ms')],
];

const CLOCK_FACTS = [
  ['offset', (clock) => fixed(clock.offset_s, 4, 's')],
  ['rate', (clock) => fixed(clock.skew_ppm, 1, 'ppm')],
  ['uncertainty', (clock) => fixed(clock.uncertainty_ms, 2, 'ms')],
  ['method', (clock) => String(clock.method ?? '–').slice(0, 60)],
];

export const links = {
  id: 'links',
  title: 'Links and clock',
  build(body) {
    const host = element('div', { class: 'cards' });
    const clock = factList("Robot's clock", CLOCK_FACTS);
    const empty = element('p', { class: 'note', text: 'No link has reported yet.' });
    const cards = new Map();
    const ended = element('p', { class: 'note', text: 'As at the end of the recording.', hidden: true });
    clock.card.hidden = true;
    body.append(empty, ended, host, clock.card);
    return {
      draw(view) {
        const known = view.session.links;
        empty.hidden = known.length > 0;
        ended.hidden = !view.isReplay || known.length === 0;
        for (const [id, card] of cards) {
          if (known.some((link) => String(link.id) === id)) continue;
          card.card.remove();
          cards.delete(id);
        }
        for (const link of known) {
          const id = String(link.id);
          let card = cards.get(id);
          if (!card) {
            card = factList('', FACTS);
            cards.set(id, card);
            host.append(card.card);
          }
          setText(card.title, String(link.name ?? id).slice(0, 80));
          card.showState(String(link.state ?? '').slice(0, 40), view.isReplay ? 0 : staleness_s(view.session.links_s, view.until_s));
          card.card.dataset.state = String(link.state ?? '').slice(0, 40);
          card.show(link);
        }
        clock.card.hidden = !view.session.clock;
        if (!view.session.clock) return;
        clock.showState('', view.isReplay ? 0 : staleness_s(view.session.clock_s, view.until_s));
        clock.show(view.session.clock);
      },
    };
  },
};

function factList(name, facts) {
  const title = element('h3', { text: name });
  const state = element('span', { class: 'state' });
  const values = facts.map(() => element('dd'));
  const card = element('section', { class: 'card' },
    element('header', {}, title, state),
    element('dl', {}, ...facts.map(([label], index) => element('div', {}, element('dt', { text: label }), values[index]))));
  const show = (record) => facts.forEach(([, text], index) => setText(values[index], text(record)));
  const showState = (text, old_s) => {
    setText(state, [text, old_s > 0 ? `${age(old_s)} ago` : ''].filter(Boolean).join(' '));
    if (card.classList.contains('stale') !== old_s > 0) card.classList.toggle('stale', old_s > 0);
  };
  return { card, title, showState, show };
}

// Lost frames, datagrams that were dropped before they were read, and requests that were not answered, if there are any.
function losses(link) {
  const parts = [count(link.lost)];
  if (link.kernel_drops > 0) parts.push(`${count(link.kernel_drops)} datagrams in the system`);
  if (link.flood_drops > 0) parts.push(`${count(link.flood_drops)} cut of floods`);
  if (link.excess_requests > 0) parts.push(`${count(link.excess_requests)} requests too many`);
  return parts.join(', ');
}
