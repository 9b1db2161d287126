// How far odometry and estimate are from the truth of the simulated robot, over time, with what the estimate claims.

import { timeAxis } from '../model/time_axis.js';
import { Chart } from '../view/chart.js';
import { element } from '../view/dom.js';
import { DASHES } from '../view/palette.js';

// More points than a minute of 50 estimates a second are thinned.
const MOST_POINTS = 3200;
// Below a tenth of a millimetre nobody looks; a logarithm needs a floor.
const FLOOR_M = 1e-4;

export const error = {
  id: 'error',
  title: 'How far off',
  isOfRobot: true,
  // Nobody knows the truth of a real robot.
  isShown: (view) => view.errors !== null && view.errors.track.length > 0,
  build(body) {
    const host = element('div');
    body.append(host, element('p', { class: 'note keys' },
      key('odometry', "brick's odometry"), key('estimate', 'estimate'), key('ellipse', 'its claim: 95 % within')));
    const chart = new Chart(host, {
      label: 'Distance from the truth over time: odometry, estimate and its claim',
      lines: [
        { label: 'claim', colour: 'ellipse', width: 1 },
        { label: 'odometry', colour: 'odometry', dash: DASHES.odometry, width: 1.8 },
        { label: 'estimate', colour: 'estimate', width: 1.8 },
      ],
      y: { isLog: true, format: (value_m) => (value_m >= 1 ? `${value_m} m` : `${Number((1000 * value_m).toPrecision(2))} mm`) },
      height: 190,
    });
    const data = [null, null, null, null];
    return {
      draw(view) {
        const track = view.errors?.track;
        if (!track) return;
        const { from_s, to_s } = timeAxis.span;
        const rows = track.shown(from_s, to_s, MOST_POINTS);
        const { t_s, claim_m, odometry_m, estimate_m } = track.columns;
        data[0] = rows.map((row) => t_s[row]);
        [claim_m, odometry_m, estimate_m].forEach((values, index) => { data[index + 1] = withGaps(values, rows); });
        chart.range = decadesOf(data.slice(1));
        chart.draw(data);
      },
    };
  },
};

function key(colour, text) {
  return element('span', { class: `key ${colour}`, text });
}

// A line ends where there is no number: uPlot takes null for that and draws through NaN.
function withGaps(values, rows) {
  return rows.map((row) => (Number.isNaN(values[row]) ? null : values[row]));
}

// Whole decades that hold all values, from at least a millimetre to at least ten centimetres.
function decadesOf(columns) {
  let low = 1e-3;
  let high = 0.1;
  for (const values of columns) {
    for (const value of values) {
      if (value === null) continue;
      if (value > high) high = value;
      else if (value < low) low = value;
    }
  }
  return [10 ** Math.floor(Math.log10(Math.max(FLOOR_M, low))), 10 ** Math.ceil(Math.log10(high))];
}
