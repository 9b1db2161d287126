// What the list of robots shows: one row for each, at a time of the session.

import { silence_s } from './silence.js';

/** Whether robots are to be told apart. */
export function hasChoice(session) {
  return session.estimated().length > 1;
}

/** The rows of all robots of a session as they were at a time, in the order in which they were heard. */
export function robotRows(session, until_s) {
  return session.estimated().map((robot) => rowOf(robot, until_s));
}

function rowOf(robot, until_s) {
  const { published } = robot;
  const row = published.rowUntil(until_s);
  // A quantity has neither fix nor ellipse.
  const read = (name) => published.columns[name]?.[row] ?? NaN;
  const silent_s = silence_s(published, until_s);
  return {
    id: robot.id,
    name: robot.name,
    state: stateOf(robot, silent_s, until_s, row),
    silent_s,
    // An estimate tells how old its fix was then; it has become older with it.
    fixAge_s: read('fix_age_s') + Math.max(0, until_s - read('t_s')),
    sigma_m: read('major_m'),
    resets: read('reset_counter'),
  };
}

function stateOf(robot, silent_s, until_s, row) {
  if (row < 0) return 'waiting';
  const isLost = robot.lost_s <= until_s && robot.published.columns.t_s[row] <= robot.lost_s;
  if (isLost) return 'lost';
  return silent_s > 0 ? 'silent' : 'live';
}
