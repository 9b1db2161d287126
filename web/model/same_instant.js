// Truth and odometry at the instant of an estimate, by the robot's own clock: estimates and samples of the truth come each with a delay of
// their own, in which a robot goes on.

// Beyond this many rows the robot's clock began again in between.
const MOST_ROWS = 256;
// Between samples that are further apart nothing is known; of a long recording only every so many-th sample is shown.
const MOST_GAP_S = 0.5;
const MOST_SPACINGS = 4;

/** The last row up to a time whose instant is one that the truth has told as well; -1 when there is none. */
export function comparableRow(estimates, truth, until_s) {
  const last = estimates.rowUntil(until_s);
  const told = truth.rowUntil(until_s);
  if (last < 0 || told < 0) return last;
  const told_s = truth.columns.robot_s[told];
  const times = estimates.columns.robot_s;
  const first = Math.max(estimates.begin, last - MOST_ROWS);
  for (let row = last; row >= first; row -= 1) if (times[row] <= told_s) return row;
  return last;
}

/** Fills a pose with the truth's columns `names` (x, y, heading) at an instant of the robot's clock; says whether they are known. */
export function readTruth(into, truth, until_s, robot_s, [x, y, heading]) {
  const after = rowFrom(truth, truth.rowUntil(until_s), robot_s);
  if (after < 0) return false;
  const { columns } = truth;
  const before = Math.max(truth.begin, after - 1);
  const gap_s = columns.robot_s[after] - columns.robot_s[before];
  if (gap_s > Math.max(MOST_GAP_S, MOST_SPACINGS * truth.spacing_s())) return false;
  const share = gap_s > 0 ? (robot_s - columns.robot_s[before]) / gap_s : 1;
  const between = (name) => columns[name][before] + share * (columns[name][after] - columns[name][before]);
  const turn_rad = columns[heading][after] - columns[heading][before];
  into.t_s = columns.t_s[after];
  into.x_m = between(x);
  into.y_m = between(y);
  into.heading_rad = columns[heading][before] + share * Math.atan2(Math.sin(turn_rad), Math.cos(turn_rad));
  return !Number.isNaN(into.x_m + into.y_m);
}

// The first row at or after an instant of the robot's clock, near `row`; -1 when there is none.
function rowFrom(track, row, robot_s) {
  if (row < 0) return -1;
  const times = track.columns.robot_s;
  const first = Math.max(track.begin, row - MOST_ROWS);
  const last = Math.min(track.end - 1, row + MOST_ROWS);
  let found = row;
  while (found < last && times[found] < robot_s) found += 1;
  while (found > first && times[found - 1] >= robot_s) found -= 1;
  return times[found] >= robot_s ? found : -1;
}
