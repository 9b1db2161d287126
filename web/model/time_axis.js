// The time axis that all charts share: which span they show, and the instant at which somebody points in one of them.

export const MINUTE_S = 60;
const LEAST_S = 10;
// A shorter drag is a click.
const SHORTEST_S = 0.05;

export class TimeAxis {
  constructor() {
    /** What is shown unless a piece of it was chosen: the `minute` until now, or the whole `run`. */
    this.base = 'minute';
    /** The chosen piece as from and to; null without one. */
    this.chosen = null;
    /** The instant that is pointed at; NaN when none is. */
    this.cursor_s = NaN;
    this.onChange = () => {};
    this.held = null;
    this.span = { from_s: 0, to_s: 1, until_s: 1 };
  }

  /** Works out the span for a run from `begin_s` to `end_s` that is shown as it was at `until_s`: live its end, in a replay before it. */
  look(begin_s, end_s, until_s) {
    const [from_s, to_s] = this.held ?? this.chosen ?? this.#usual(begin_s, Math.max(end_s, until_s), until_s);
    this.span = { from_s, to_s, until_s };
  }

  get isZoomed() {
    return this.chosen !== null;
  }

  show(base) {
    this.base = base;
    this.chosen = null;
    this.onChange();
  }

  zoom(from_s, to_s) {
    if (to_s - from_s < SHORTEST_S) return;
    this.chosen = [from_s, to_s];
    this.onChange();
  }

  point(t_s) {
    this.cursor_s = t_s;
    this.onChange();
  }

  /** The span stands still while somebody chooses a piece of it. */
  hold(isHeld) {
    this.held = isHeld ? [this.span.from_s, this.span.to_s] : null;
  }

  #usual(begin_s, end_s, until_s) {
    // It grows to a minute, so that the beginning of a run is not squeezed into a corner.
    if (this.base === 'minute') return [Math.max(until_s - MINUTE_S, Math.min(begin_s, until_s - LEAST_S)), until_s];
    return [Math.min(begin_s, end_s - 1), end_s];
  }
}

/** There is one page, and so one axis. */
export const timeAxis = new TimeAxis();
