// A pose in numbers, for those who do not drag: x and y in metres, the heading in degrees.

import { button, element } from './dom.js';

export class PoseForm {
  /** @param {(pose: {x_m: number, y_m: number, heading_rad: number}) => void} onPose */
  constructor(onPose) {
    const fields = [field('x', 'm'), field('y', 'm'), field('heading', '°')];
    this.inputs = fields.map(({ input }) => input);
    const set = button('Set', () => {
      for (const input of this.inputs) if (!input.reportValidity()) return;
      const [x_m, y_m, heading_deg] = this.inputs.map((input) => input.valueAsNumber);
      onPose({ x_m, y_m, heading_rad: (heading_deg * Math.PI) / 180 });
    });
    this.row = element('div', { class: 'hand' }, ...fields.map(({ label }) => label), set);
  }

  /** Begins with an estimate, if there is one. */
  fill(estimate) {
    const values = [estimate?.x_m, estimate?.y_m, ((estimate?.heading_rad ?? NaN) * 180) / Math.PI];
    this.inputs.forEach((input, index) => { input.value = Number.isFinite(values[index]) ? String(Number(values[index].toFixed(2))) : '0'; });
  }

  focus() {
    this.inputs[0].focus();
  }
}

function field(label, unit) {
  const input = element('input', { type: 'number', step: 'any', required: true, inputmode: 'decimal', value: '0' });
  return { input, label: element('label', {}, `${label} `, input, ` ${unit}`) };
}
