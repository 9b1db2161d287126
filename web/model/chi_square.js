// Where a normalised innovation squared (NIS) lies in 95 of 100 cases, by degrees of freedom.
//
// Quantiles 0.025 and 0.975 of the chi-square distribution; Bar-Shalom, Li and Kirubarajan (2001), section 5.4. The test
// `model.test.mjs` integrates the density up to each of them.

export const NIS_BAND_95 = Object.freeze({
  1: Object.freeze([0.000982, 5.0239]),
  2: Object.freeze([0.050636, 7.3778]),
  3: Object.freeze([0.215795, 9.3484]),
});

/** The band for a number of degrees of freedom, or null where there is none. */
export function nisBand(degreesOfFreedom) {
  return NIS_BAND_95[degreesOfFreedom] ?? null;
}
