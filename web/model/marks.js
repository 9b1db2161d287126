// What became of an observation, as the page tells them apart. Each has a colour and a mark of its own.

export const MARKS = Object.freeze({ accepted: 0, late: 1, gated: 2, tooOld: 3, resetTo: 4, other: 5 });

export const MARK_WORDS = Object.freeze(['accepted', 'applied late', 'gated', 'too old', 'reset to', 'not used']);

// An accepted fix counts as late when it was applied this far behind the filter's time: three readings of a brick at 20 Hz, by when a
// robot at 0.2 m/s has gone 3 cm.
export const LATE_FROM_S = 0.15;

const BY_VERDICT = new Map([
  ['accepted', MARKS.accepted],
  ['slip', MARKS.accepted],
  ['gated', MARKS.gated],
  ['too old', MARKS.tooOld],
  ['reset to', MARKS.resetTo],
]);

/** Whether an observation was refused. */
export function isRefused(mark) {
  return mark === MARKS.gated || mark === MARKS.tooOld;
}

/** Whether an observation was not used, for whatever reason. */
export function isNotUsed(mark) {
  return isRefused(mark) || mark === MARKS.other;
}

/** The mark of a verdict (as `telemetry::Verdict::reason` words it) and a lag in seconds. */
export function markOf(verdict, lag_s) {
  const mark = BY_VERDICT.get(verdict) ?? MARKS.other;
  return mark === MARKS.accepted && lag_s >= LATE_FROM_S ? MARKS.late : mark;
}
