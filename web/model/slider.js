// How a slider's position in 0 to 1 maps to a parameter. Parameters span decades: over three of them a slider is logarithmic, and one that
// begins at zero but is usually small goes by the third power, so that the usual values have room.

const DECADES_FOR_LOG = 1000;
const SMALL_DEFAULT = 0.05;

/** The scale of a parameter `{least, most, default}`. */
export function scaleOf({ least, most, default: usual }) {
  if (least > 0 && most / least >= DECADES_FOR_LOG) {
    const span = Math.log(most / least);
    return { toValue: (at) => least * Math.exp(span * at), toPosition: (value) => Math.log(value / least) / span };
  }
  const width = most - least;
  if (!(width > 0)) return { toValue: () => least, toPosition: () => 0 };
  const power = least === 0 && usual / most < SMALL_DEFAULT ? 3 : 1;
  return {
    toValue: (at) => least + width * at ** power,
    toPosition: (value) => ((value - least) / width) ** (1 / power),
  };
}

/** A value that people would write: four significant digits, within the range. */
export function rounded(value, { least, most }) {
  return Math.min(most, Math.max(least, Number(value.toPrecision(4))));
}
