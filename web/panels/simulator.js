// Hands on the simulated brick: every fault that a robot, its camera or its link may have, and the steering.

import { button, element } from '../view/dom.js';
import { Driver } from '../view/driver.js';

const DEGREE_RAD = Math.PI / 180;

export const simulator = {
  id: 'simulator',
  title: 'Hands on: the simulated brick',
  isLive: true,
  isOfRobot: true,
  isShown: (view) => view.hasSimulator,
  build: (body, station) => new SimulatorPanel(body, station),
};

class SimulatorPanel {
  constructor(body, station) {
    this.station = station;
    this.known = null;
    this.driver = new Driver((command) => station.commandRobot(command));
    this.host = element('div', { class: 'hands' });
    body.append(this.host);
  }

  draw() {
    const known = this.station.simulator;
    if (known === this.known) {
      this.#showSettings();
      return;
    }
    this.known = known;
    this.shown = {};
    this.driver.disarm();
    this.host.replaceChildren(...(known ? this.#rows(known) : []));
    this.#showSettings();
  }

  // What is told anew, and only that: a profile that is chosen but not yet asked for stays chosen.
  #showSettings() {
    const { known, shown } = this;
    if (!known) return;
    if (shown.steering !== known.steering) {
      shown.steering = known.steering;
      for (const radio of this.steering) radio.checked = radio.value === known.steering;
    }
    if (shown.link_profile !== known.link_profile) {
      shown.link_profile = known.link_profile;
      this.profile.write(known.link_profile ?? '');
    }
  }

  /** While a recording is shown nobody drives, and nobody drives on with another robot. */
  rest() {
    this.driver.disarm();
  }

  #rows(known) {
    return [this.#kidnap(), this.#slip(), this.#camera(), this.#delay(), this.#gyro(), this.#profile(known), this.#cable(), this.#steering(), this.driver.build()];
  }

  #kidnap() {
    const forward = number('ahead m', 0.3, -10, 10);
    const left = number('left m', 0.2, -10, 10);
    const turn = number('turn °', 60, -180, 180);
    return row('Kidnap', () => ({ command: 'kidnap', forward_m: forward.read(), left_m: left.read(), turn_rad: turn.read() * DEGREE_RAD }),
      'Lift the robot and put it down elsewhere; its wheels spin in the air and count.', this.station, forward.label, left.label, turn.label);
  }

  #slip() {
    const wheel = choice('wheel', [['left', 'left'], ['right', 'right'], ['both', 'both']]);
    const factor = number('loses %', 80, 0, 100);
    const seconds = number('for s', 1, 0.1, 60);
    return row('Slip', () => ({ command: 'slip', wheel: wheel.read(), factor: factor.read() / 100, seconds: seconds.read() }),
      'Let wheels lose that share of their travel: they count more than the body moves.', this.station, wheel.label, factor.label, seconds.label);
  }

  #camera() {
    return element('div', { class: 'hand' },
      button('Camera off', () => this.station.commandRobot({ command: 'camera', on: false }), { title: 'No more fixes: the ellipse grows.' }),
      button('Camera on', () => this.station.commandRobot({ command: 'camera', on: true }), { title: 'Fixes again.' }));
  }

  #delay() {
    const delay = number('by ms', 300, 0, 5000);
    return row('Camera late', () => ({ command: 'camera-delay', delay_ms: delay.read() }), 'Fixes arrive that much later than they were taken.', this.station, delay.label);
  }

  #gyro() {
    const step = number('by °/s', 3, -57, 57);
    return row('Gyro bias step', () => ({ command: 'gyro-bias-step', rad_per_s: step.read() * DEGREE_RAD }), 'The zero of the gyro jumps, as after a knock.', this.station, step.label);
  }

  #profile(known) {
    const names = Array.isArray(known.link_profiles) ? known.link_profiles.map(String) : [];
    const profile = choice('as bad as', [['', 'a cable'], ...names.map((name) => [name, name])]);
    this.profile = profile;
    return row('Link', () => ({ command: 'link-profile', profile: profile.read() || null }), 'Make the link as bad as one of the profiles.', this.station, profile.label);
  }

  #cable() {
    const seconds = number('for s', 3, 0.1, 60);
    return row('Pull the cable', () => ({ command: 'pull-cable', seconds: seconds.read() }), 'The link is gone and comes back.', this.station, seconds.label);
  }

  #steering() {
    this.steering = ['odometry', 'estimate'].map((by) => element('input', { type: 'radio', name: 'steering', value: by, on: { change: () => this.station.commandRobot({ command: 'steering', by }) } }));
    const options = this.steering.map((radio) => element('label', {}, radio, ` ${radio.value}`));
    return element('fieldset', { class: 'hand' }, element('legend', { text: 'Steer by' }), ...options);
  }
}

// A button with its fields; nothing is sent while a field holds no number in its range.
function row(text, command, title, station, ...labels) {
  const line = element('div', { class: 'hand' });
  const go = button(text, () => {
    for (const input of line.querySelectorAll('input')) if (!input.reportValidity()) return;
    station.commandRobot(command());
  }, { title, class: 'act' });
  line.append(go, ...labels);
  return line;
}

function number(text, value, least, most) {
  const input = element('input', { type: 'number', value, min: least, max: most, step: 'any', required: true, inputmode: 'decimal' });
  return { label: element('label', {}, `${text} `, input), read: () => input.valueAsNumber };
}

function choice(text, options) {
  const select = element('select', {}, ...options.map(([value, name]) => element('option', { value, text: name })));
  return { label: element('label', {}, `${text} `, select), read: () => select.value, write: (value) => { select.value = value; } };
}
