// The line at the head of the page: how far off, as the terminal has it.

import { metres } from './format.js';

/** Of what is shown: `errors` of the robot, the time, the robot itself, and whether it is one of several. */
export function headline({ errors, robot, until_s, isOneOfMany }) {
  const whose = isOneOfMany && robot ? `${robot.label}: ` : '';
  const odometry_m = errors?.recent('odometry_m', until_s) ?? NaN;
  if (Number.isFinite(odometry_m)) {
    const estimate_m = errors.recent('estimate_m', until_s);
    const estimate = Number.isFinite(estimate_m) ? `estimate ${metres(estimate_m)} off` : 'estimate not known';
    return `${whose}odometry ${metres(odometry_m)} off, ${estimate}`;
  }
  if (!robot) return 'Waiting for a robot…';
  const row = robot.estimates.rowUntil(until_s);
  const isRelative = row >= 0 && robot.estimates.columns.is_relative[row] === 1;
  return isRelative ? `robot ${robot.label}, relative to where it started` : `robot ${robot.label}`;
}
