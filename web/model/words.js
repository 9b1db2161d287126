// Words as numbers, for the columns of a track; no more than there may be.

const MOST_WORDS = 64;
const MOST_LETTERS = 40;

export class Words {
  #known = [];

  /** NaN beyond the most. */
  number(word) {
    const text = String(word).slice(0, MOST_LETTERS);
    const known = this.#known.indexOf(text);
    if (known >= 0) return known;
    return this.#known.length < MOST_WORDS ? this.#known.push(text) - 1 : NaN;
  }

  /** Empty for a number that has no word. */
  text(number) {
    return this.#known[number] ?? '';
  }
}
