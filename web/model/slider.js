// How a slider's position in 0 to 1 maps to a parameter. Parameters span decades: over three of them a slider is logarithmic, and one that
// begins at zero but is usually small goes by the third power, so that the usual values have room. A probability near one goes by the logarithm of
// what it lacks: from 0.9 to 0.99 is as far as from 0.99 to 0.999.

const DECADES_FOR_LOG = 1000;
const SMALL_DEFAULT = 0.05;

/** The scale of a parameter `{least, most, default}`. */
export function scaleOf({ least, most, default: usual }) {
  if (isNearOne({ least, most })) {
    const span = Math.log((1 - most) / (1 - least));
    return { toValue: (at) => 1 - (1 - least) * Math.exp(span * at), toPosition: (value) => Math.log((1 - value) / (1 - least)) / span };
  }
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

/** A value that people would write, within the range: four significant digits, of a probability near one two of what it lacks. */
export function rounded(value, { least, most }) {
  const short = isNearOne({ least, most }) ? Number((1 - Number((1 - value).toPrecision(2))).toPrecision(12)) : Number(value.toPrecision(4));
  return Math.min(most, Math.max(least, short));
}

// A range of probabilities whose complement spans decades.
function isNearOne({ least, most }) {
  return least > 0 && most < 1 && (1 - least) / (1 - most) >= DECADES_FOR_LOG;
}
