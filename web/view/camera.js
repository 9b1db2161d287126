// How the map looks at the arena: centre, scale, and the two conversions. Metres, x east to the right, y north up; pixels are CSS pixels.

const SMALLEST_PX_PER_M = 4;
const LARGEST_PX_PER_M = 40000;
const MARGIN_PX = 36;

export class Camera {
  constructor() {
    this.x_m = 0;
    this.y_m = 0;
    this.px_per_m = 200;
    this.width_px = 1;
    this.height_px = 1;
  }

  toX(x_m) {
    return this.width_px / 2 + (x_m - this.x_m) * this.px_per_m;
  }

  toY(y_m) {
    return this.height_px / 2 - (y_m - this.y_m) * this.px_per_m;
  }

  toArena(x_px, y_px) {
    return {
      x_m: this.x_m + (x_px - this.width_px / 2) / this.px_per_m,
      y_m: this.y_m - (y_px - this.height_px / 2) / this.px_per_m,
    };
  }

  pan(dx_px, dy_px) {
    this.x_m -= dx_px / this.px_per_m;
    this.y_m += dy_px / this.px_per_m;
  }

  /** Zooms so that the point under a pixel stays there. */
  zoom(factor, x_px = this.width_px / 2, y_px = this.height_px / 2) {
    const before = this.toArena(x_px, y_px);
    this.px_per_m = Math.min(LARGEST_PX_PER_M, Math.max(SMALLEST_PX_PER_M, this.px_per_m * factor));
    const after = this.toArena(x_px, y_px);
    this.x_m += before.x_m - after.x_m;
    this.y_m += before.y_m - after.y_m;
  }

  /** Shows a box with a margin, beside what is kept free at the right and at the top. */
  fit(box, { right_px, top_px }) {
    const width_m = Math.max(0.3, box.right_m - box.left_m);
    const height_m = Math.max(0.3, box.top_m - box.bottom_m);
    const scale = Math.min((this.width_px - right_px - 2 * MARGIN_PX) / width_m, (this.height_px - top_px - 2 * MARGIN_PX) / height_m);
    this.px_per_m = Math.min(LARGEST_PX_PER_M, Math.max(SMALLEST_PX_PER_M, scale));
    this.x_m = (box.left_m + box.right_m) / 2 + right_px / 2 / this.px_per_m;
    this.y_m = (box.bottom_m + box.top_m) / 2 + top_px / 2 / this.px_per_m;
  }
}

/** A box that grows. */
export class Box {
  constructor() {
    this.clear();
  }

  clear() {
    this.left_m = Infinity;
    this.right_m = -Infinity;
    this.bottom_m = Infinity;
    this.top_m = -Infinity;
  }

  get isEmpty() {
    return this.left_m > this.right_m;
  }

  add(x_m, y_m) {
    if (!Number.isFinite(x_m) || !Number.isFinite(y_m)) return;
    this.left_m = Math.min(this.left_m, x_m);
    this.right_m = Math.max(this.right_m, x_m);
    this.bottom_m = Math.min(this.bottom_m, y_m);
    this.top_m = Math.max(this.top_m, y_m);
  }
}
