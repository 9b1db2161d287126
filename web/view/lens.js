// The lens: a round window in a corner of the map that looks at the estimate so closely that its ellipse can be seen.
//
// An estimate is good to millimetres, an arena is metres wide: at the map's scale ellipse and error vanish.

import { drawCone, drawEllipse, drawFixes } from './arena_scene.js';
import { Camera } from './camera.js';
import { roundUp } from './chart.js';
import { palette } from './palette.js';

// The lens is this many times as wide as the larger of ellipse and error.
const WIDTH_BY_SIZE = 3.2;
const NARROWEST_M = 0.01;
const FIXES_S = 1.5;
const EDGE_PX = 12;

export class Lens {
  constructor() {
    this.camera = new Camera();
    this.width_m = 0.1;
  }

  /** Draws around the estimate; `truth` is null where nobody knows it; `alpha` fades an estimate that nobody renews. */
  draw(context, map, view) {
    const { estimate, truth, fixes, until_s } = view;
    if (Number.isNaN(estimate.x_m + estimate.y_m)) return;
    const radius_px = radiusOn(map);
    const x_px = map.width_px - radius_px - EDGE_PX;
    const y_px = radius_px + EDGE_PX;
    this.#adjust(estimate, truth, radius_px);
    context.save();
    this.#frame(context, x_px, y_px, radius_px);
    context.clip();
    context.translate(x_px - radius_px, y_px - radius_px);
    context.globalAlpha = view.alpha;
    drawEllipse(context, this.camera, estimate);
    drawCone(context, this.camera, estimate);
    context.globalAlpha = 1;
    drawFixes(context, this.camera, fixes, until_s, FIXES_S);
    this.#points(context, estimate, truth);
    context.restore();
    this.#scale(context, x_px, y_px, radius_px);
  }

  // The width follows in steps, and gets smaller only when it is far too large, so that it does not pump.
  #adjust(estimate, truth, radius_px) {
    const error_m = truth ? Math.hypot(truth.x_m - estimate.x_m, truth.y_m - estimate.y_m) : 0;
    const wanted_m = roundUp(Math.max(NARROWEST_M, WIDTH_BY_SIZE * Math.max(estimate.major_m || 0, Math.min(error_m, 1))));
    if (wanted_m > this.width_m || wanted_m < this.width_m / 2.4) this.width_m = wanted_m;
    const camera = this.camera;
    camera.width_px = 2 * radius_px;
    camera.height_px = 2 * radius_px;
    camera.x_m = estimate.x_m;
    camera.y_m = estimate.y_m;
    camera.px_per_m = (2 * radius_px) / this.width_m;
  }

  #frame(context, x_px, y_px, radius_px) {
    context.beginPath();
    context.arc(x_px, y_px, radius_px, 0, 2 * Math.PI);
    context.fillStyle = palette.panel;
    context.fill();
    context.lineWidth = 1.5;
    context.strokeStyle = palette.faint;
    context.stroke();
  }

  #points(context, estimate, truth) {
    context.lineWidth = 2;
    context.fillStyle = palette.estimate;
    context.beginPath();
    context.arc(this.camera.toX(estimate.x_m), this.camera.toY(estimate.y_m), 3.5, 0, 2 * Math.PI);
    context.fill();
    if (!truth) return;
    const x = this.camera.toX(truth.x_m);
    const y = this.camera.toY(truth.y_m);
    context.strokeStyle = palette.truth;
    context.beginPath();
    context.arc(x, y, 5, 0, 2 * Math.PI);
    context.moveTo(x - 8, y);
    context.lineTo(x + 8, y);
    context.moveTo(x, y - 8);
    context.lineTo(x, y + 8);
    context.stroke();
  }

  #scale(context, x_px, y_px, radius_px) {
    const bar_m = roundUp(this.width_m / 5);
    const half_px = (bar_m * this.camera.px_per_m) / 2;
    const y = y_px + 0.72 * radius_px;
    context.strokeStyle = palette.ink;
    context.fillStyle = palette.ink;
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(x_px - half_px, y);
    context.lineTo(x_px + half_px, y);
    context.stroke();
    context.font = '11px system-ui, sans-serif';
    context.textAlign = 'center';
    context.fillText(bar_m < 0.1 ? `${Math.round(1000 * bar_m)} mm` : `${bar_m.toFixed(1)} m`, x_px, y - 4);
    context.textAlign = 'start';
  }
}

/** How much of a map the lens takes: its diameter with the space around it. */
export function lensSize_px(map) {
  return 2 * (radiusOn(map) + EDGE_PX);
}

function radiusOn(map) {
  return Math.max(46, Math.min(86, 0.13 * Math.min(map.width_px, map.height_px) + 12));
}
