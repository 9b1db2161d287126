// Sliders and fields for the filter's parameters, made from the table that the station sends.

import { rounded, scaleOf } from '../model/slider.js';
import { button, element } from '../view/dom.js';
import { compact } from '../view/format.js';

const STEPS = 1000;

export const parameters = {
  id: 'parameters',
  title: 'Parameters of the filter',
  isLive: true,
  build: (body, station) => new ParametersPanel(body, station),
};

class ParametersPanel {
  constructor(body, station) {
    this.station = station;
    this.known = null;
    this.rows = new Map();
    this.host = element('div', { class: 'parameters' });
    const ask = (command) => () => station.command({ command });
    body.append(this.host, element('div', { class: 'actions' },
      button('Defaults', ask('default-parameters'), { title: 'All parameters as they come' }),
      button('Reload', ask('reload-parameters'), { title: 'All parameters as they were saved' }),
      button('Save', ask('save-parameters'), { title: 'Keep these parameters for the next run' })));
  }

  draw() {
    const known = this.station.parameters;
    if (known !== this.known) {
      this.known = known;
      this.rows.clear();
      this.host.replaceChildren(...[...known.values()].map((parameter) => this.#row(parameter)));
    }
    for (const [name, row] of this.rows) row.show(known.get(name).value);
  }

  #row(parameter) {
    const { name, unit, help, least, most } = parameter;
    const scale = scaleOf(parameter);
    const id = `parameter-${name}`;
    const slider = element('input', { type: 'range', min: 0, max: STEPS, step: 1, 'aria-label': `${name}, slider`, title: `${compact(least)} to ${compact(most)} ${unit}`, list: `${id}-default` });
    const field = element('input', { type: 'number', id, min: least, max: most, step: 'any', inputmode: 'decimal', 'aria-describedby': `${id}-help` });
    const reset = button('↺', () => send(parameter.default), { 'aria-label': `${name} back to ${compact(parameter.default)}`, title: `default ${compact(parameter.default)} ${unit}` });
    const mark = element('datalist', { id: `${id}-default` }, element('option', { value: Math.round(STEPS * scale.toPosition(parameter.default)) }));
    const send = (value) => this.station.command({ command: 'set-parameter', name, value });
    slider.addEventListener('input', () => { field.value = compactNumber(rounded(scale.toValue(slider.value / STEPS), parameter)); });
    slider.addEventListener('change', () => send(rounded(scale.toValue(slider.value / STEPS), parameter)));
    field.addEventListener('change', () => { if (field.value !== '' && field.reportValidity()) send(field.valueAsNumber); });
    this.rows.set(name, { show: (value) => show(value, { slider, field, reset, scale, parameter }) });
    return element('div', { class: 'parameter', 'data-name': name },
      element('label', { for: id, title: help }, name, element('span', { class: 'unit', text: unit ? ` ${unit}` : '' })),
      slider, mark, field, reset, element('p', { class: 'help', id: `${id}-help`, text: help }));
  }
}

// Shows a value, unless a person is at it.
function show(value, { slider, field, reset, scale, parameter }) {
  const isChanged = value !== parameter.default;
  if (reset.disabled === isChanged) reset.disabled = !isChanged;
  if (field.dataset.value === String(value)) return;
  if (document.activeElement === field || slider.matches(':active')) return;
  field.dataset.value = String(value);
  field.value = compactNumber(value);
  slider.value = String(Math.round(STEPS * scale.toPosition(value)));
  slider.setAttribute('aria-valuetext', `${compact(value)} ${parameter.unit}`);
}

function compactNumber(value) {
  return String(Number(value.toPrecision(7)));
}
