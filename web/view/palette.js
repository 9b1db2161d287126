// The colours that canvases draw with, read from the style sheet, so that light and dark stand in one place.
//
// They are those of M. Okabe and K. Ito, Color Universal Design (2008), which stay apart for colour-blind readers; lines differ in their
// dashes and marks in their shape as well.

const NAMES = ['truth', 'odometry', 'estimate', 'ellipse', 'accepted', 'late', 'gated', 'old', 'reset', 'ink', 'faint', 'grid', 'panel', 'path', 'other', 'wall', 'place'];

export const palette = {};

/** Reads the colours anew, after the theme changed. */
export function readPalette() {
  const style = getComputedStyle(document.documentElement);
  for (const name of NAMES) palette[name] = style.getPropertyValue(`--${name}`).trim();
}

/** Colours of `model/marks.js`, by mark. */
export function markColour(mark) {
  return palette[['accepted', 'late', 'gated', 'old', 'reset', 'faint'][mark] ?? 'faint'];
}

// After the colours come the same ones dashed: eight filters stay apart.
const COMPARED = ['#E69F00', '#009E73', '#CC79A7', '#56B4E9'];
const COMPARED_DASH = [6, 3];

/** The colours of the filters that run beside the one that sends, in the order in which they were heard. */
export const ComparedColours = Object.freeze({
  of: (robot, filter) => COMPARED[Math.max(0, [...robot.compared.keys()].indexOf(filter)) % COMPARED.length],
  dash: (robot, filter) => ([...robot.compared.keys()].indexOf(filter) >= COMPARED.length ? COMPARED_DASH : []),
});

export const DASHES = Object.freeze({ truth: [], odometry: [7, 4], estimate: [], path: [2, 4] });
