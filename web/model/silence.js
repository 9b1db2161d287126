// Whether a robot is heard: an estimate that stands still because its link is out looks as good as one of now.

// A robot tells something twenty times a second or oftener; what a bad link delays comes within a second.
export const SILENT_FROM_S = 1;
// Of a long recording only every so many-th estimate is shown: silence is several times their usual distance.
export const SILENT_SPACINGS = 4;

/** For how many seconds no estimate has come before a time; 0 as long as that is as usual, or there is none at all. */
export function silence_s(estimates, until_s) {
  const last = estimates ? estimates.rowUntil(until_s) : -1;
  if (last < 0) return 0;
  const silent_s = until_s - estimates.columns.t_s[last];
  return silent_s >= Math.max(SILENT_FROM_S, SILENT_SPACINGS * estimates.spacing_s()) ? silent_s : 0;
}
