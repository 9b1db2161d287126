// Whether a robot is heard: an estimate that stands still because its link is out looks as good as one of now.

// A robot tells something twenty times a second or oftener; what a bad link delays comes within a second.
export const SILENT_FROM_S = 1;
// Of a long recording only every so many-th estimate is shown: silence is several times their usual distance.
export const SILENT_SPACINGS = 4;

// What is told once a second is old when it was not told twice.
const OLD_FROM_S = 2;

/** How old is what is told once a second; 0 as long as that is as usual. */
export function staleness_s(told_s, until_s) {
  return until_s - told_s >= OLD_FROM_S ? until_s - told_s : 0;
}

/** For how many seconds no estimate has come before a time; 0 as long as that is as usual, or there is none at all. */
export function silence_s(estimates, until_s) {
  const last = estimates ? estimates.rowUntil(until_s) : -1;
  if (last < 0) return 0;
  const silent_s = until_s - estimates.columns.t_s[last];
  return silent_s >= Math.max(SILENT_FROM_S, SILENT_SPACINGS * estimates.spacing_s()) ? silent_s : 0;
}
