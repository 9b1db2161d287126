// Numbers for people: degrees, millimetres below a metre, a dash for what is not known.

const NONE = '–';

export function metres(value_m) {
  if (!Number.isFinite(value_m)) return NONE;
  const size_m = Math.abs(value_m);
  if (size_m >= 100) return `${value_m.toFixed(0)} m`;
  return size_m >= 0.0995 ? `${value_m.toFixed(2)} m` : `${value_m.toFixed(3)} m`;
}

export function millimetres(value_m) {
  if (!Number.isFinite(value_m)) return NONE;
  const value_mm = 1000 * value_m;
  return `${value_mm.toFixed(Math.abs(value_mm) < 10 ? 1 : 0)} mm`;
}

export function degrees(value_rad, digits = 1) {
  return Number.isFinite(value_rad) ? `${((180 / Math.PI) * value_rad).toFixed(digits)}°` : NONE;
}

export function fixed(value, digits, unit = '') {
  if (!Number.isFinite(value)) return NONE;
  return unit ? `${value.toFixed(digits)} ${unit}` : value.toFixed(digits);
}

/** Up to four significant digits, without an exponent where one can do without; what is not quite one is not shown as one. */
export function compact(value) {
  if (!Number.isFinite(value)) return NONE;
  if (value === 0) return '0';
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-4) return value.toExponential(2);
  const short = Number(value.toPrecision(4));
  return String(Math.abs(short) === 1 ? Number(value.toPrecision(7)) : short);
}

/** A value and its standard deviation, both to two digits of the latter. */
export function withSigma(value, sigma, unit = '') {
  if (!Number.isFinite(value)) return NONE;
  const digits = sigma > 0 && Number.isFinite(sigma) ? Math.min(8, Math.max(0, 1 - Math.floor(Math.log10(sigma)))) : 5;
  const text = `${value.toFixed(digits)} ± ${Number.isFinite(sigma) ? sigma.toFixed(digits) : NONE}`;
  return unit ? `${text} ${unit}` : text;
}

export function count(value) {
  return Number.isFinite(value) ? String(Math.round(value)).replace(/\B(?=(\d{3})+$)/g, ' ') : NONE;
}

export function bytes(value) {
  if (!Number.isFinite(value)) return NONE;
  if (value < 1000) return `${value.toFixed(0)} B`;
  return value < 1e6 ? `${(value / 1000).toFixed(1)} kB` : `${(value / 1e6).toFixed(1)} MB`;
}

/** Minutes and seconds of the session. */
export function clockTime(t_s) {
  if (!Number.isFinite(t_s)) return NONE;
  const whole_s = Math.max(0, t_s);
  const minutes = Math.floor(whole_s / 60);
  return `${minutes}:${(whole_s - 60 * minutes).toFixed(1).padStart(4, '0')}`;
}

/** The same in whole seconds, with hours of a long session. */
export function shortTime(t_s) {
  const whole_s = Math.round(Math.max(0, t_s));
  const [hours, minutes, seconds] = [Math.floor(whole_s / 3600), Math.floor(whole_s / 60) % 60, whole_s % 60];
  const two = (value) => String(value).padStart(2, '0');
  return hours > 0 ? `${hours}:${two(minutes)}:${two(seconds)}` : `${minutes}:${two(seconds)}`;
}

/** How long ago, for what is old. */
export function age(age_s) {
  if (age_s < 10) return `${age_s.toFixed(1)} s`;
  return age_s < 120 ? `${Math.floor(age_s)} s` : `${Math.floor(age_s / 60)} min`;
}
