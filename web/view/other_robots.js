// The robots besides the chosen one on the map: an outline, a short trail and a name each, in one muted colour.
//
// There may be 63 of them and they are drawn with every frame of the screen: all trails are one stroke, and so are all outlines.

import { silence_s } from '../model/silence.js';
import { palette } from './palette.js';

const TRAIL_S = 10;
const MOST_TRAIL_POINTS = 60;
export const SILENT_DASH = [3, 3];
// As long as a leap in `drawTrail`: what is further is no drive.
const LEAP_M = 0.15;
const HALF_LENGTH_M = 0.055;
const SMALLEST_PX = 5;
const FONT = '12px system-ui, sans-serif';
const CHOSEN_FONT = '600 12px system-ui, sans-serif';
const LABEL_HEIGHT_PX = 14;
// A click within this distance of a robot is for it: a finger's width.
const TAP_PX = 22;
// The outline of a robot, nose ahead, in half lengths.
const OUTLINE = [[1, 0], [0.35, 0.62], [-0.75, 0.62], [-0.75, -0.62], [0.35, -0.62]];

export class OtherRobots {
  constructor() {
    /** Of each robot where it is on the map. */
    this.places = [];
    this.count = 0;
    this.widths = new Map();
    this.labels = [];
  }

  /** Finds where all robots of a session are at a time; `chosen` is one of them or null. */
  read(session, chosen, until_s) {
    this.count = 0;
    for (const robot of session.estimated()) {
      const { estimates } = robot;
      const row = estimates.rowUntil(until_s);
      if (row < 0) continue;
      const { t_s, x_m, y_m, heading_rad, is_relative } = estimates.columns;
      if (Number.isNaN(x_m[row] + y_m[row])) continue;
      // Each that is relative to its start has an origin of its own.
      if (robot !== chosen && (is_relative[row] === 1 || isRelative(chosen, until_s))) continue;
      this.places[this.count] ??= {};
      const place = this.places[this.count];
      place.robot = robot;
      place.isChosen = robot === chosen;
      place.isSilent = silence_s(estimates, until_s) > 0;
      place.x_m = x_m[row];
      place.y_m = y_m[row];
      place.heading_rad = heading_rad[row] || 0;
      place.end = row + 1;
      place.begin = estimates.sameFrom('is_relative', estimates.rowAt(t_s[row] - TRAIL_S), place.end);
      this.count += 1;
    }
    this.places.length = this.count;
  }

  /** Adds where they are and were to a box. */
  addTo(box) {
    this.#eachTrailPoint((x_m, y_m) => box.add(x_m, y_m));
  }

  /** Draws all but the chosen one; the outline of a silent one is dashed. Of names that would cover each other one is left out. */
  draw(context, camera) {
    context.strokeStyle = palette.other;
    this.#drawTrails(context, camera);
    this.labels.length = 0;
    const chosen = this.places.find((place) => place.isChosen);
    if (chosen && this.count > 1) this.labels.push(this.#label(context, camera, chosen, CHOSEN_FONT));
    for (const place of this.places) if (!place.isChosen) this.#drawName(context, camera, place);
    context.fillStyle = palette.panel;
    context.strokeStyle = palette.other;
    context.lineWidth = 1.4;
    for (const isSilent of [false, true]) {
      context.setLineDash(isSilent ? SILENT_DASH : []);
      context.beginPath();
      for (const place of this.places) if (!place.isChosen && place.isSilent === isSilent) addOutline(context, camera, place);
      context.fill();
      context.stroke();
    }
    context.setLineDash([]);
  }

  /** Writes the name of the chosen one, over all else; `draw` has left room for it. */
  drawChosenName(context) {
    const [label] = this.labels;
    if (label?.place.isChosen) write(context, label, palette.estimate);
  }

  /** The robot that is meant by a click, or null. */
  at(camera, x_px, y_px) {
    let nearest = null;
    let least_px = Math.max(TAP_PX, halfLength_px(camera));
    for (const place of this.places) {
      const away_px = Math.hypot(camera.toX(place.x_m) - x_px, camera.toY(place.y_m) - y_px);
      if (away_px > least_px) continue;
      least_px = away_px;
      nearest = place.robot;
    }
    return nearest;
  }

  #drawTrails(context, camera) {
    context.beginPath();
    let last = null;
    let lastX_m = 0;
    let lastY_m = 0;
    this.#eachTrailPoint((x_m, y_m, place) => {
      if (place.isChosen) return;
      const isLeap = last !== place || Math.hypot(x_m - lastX_m, y_m - lastY_m) > place.leap_m;
      if (isLeap) context.moveTo(camera.toX(x_m), camera.toY(y_m));
      else context.lineTo(camera.toX(x_m), camera.toY(y_m));
      last = place;
      lastX_m = x_m;
      lastY_m = y_m;
    });
    context.globalAlpha = 0.55;
    context.lineJoin = 'round';
    context.lineWidth = 1.2;
    context.stroke();
    context.globalAlpha = 1;
  }

  #eachTrailPoint(take) {
    for (const place of this.places) {
      const { x_m, y_m } = place.robot.estimates.columns;
      const step = Math.max(1, Math.ceil((place.end - place.begin) / MOST_TRAIL_POINTS));
      place.leap_m = LEAP_M * step;
      // At multiples of the step, so that the same points are taken frame by frame: else the trail would tremble.
      const first = place.begin + ((step - (place.begin % step)) % step);
      for (let row = first; row < place.end - 1; row += step) if (!Number.isNaN(x_m[row] + y_m[row])) take(x_m[row], y_m[row], place);
      take(place.x_m, place.y_m, place);
    }
  }

  #drawName(context, camera, place) {
    const label = this.#label(context, camera, place, FONT);
    if (this.labels.some((other) => covers(label, other))) return;
    this.labels.push(label);
    write(context, label, palette.other);
  }

  #label(context, camera, place, font) {
    const text = place.robot.label;
    return labelOf(camera, place, text, font, this.#width_px(context, text, font));
  }

  // To measure a text costs more than to draw it.
  #width_px(context, text, font) {
    const key = `${font}\n${text}`;
    let width_px = this.widths.get(key);
    if (width_px === undefined) {
      context.font = font;
      width_px = context.measureText(text).width;
      if (this.widths.size > 1000) this.widths.clear();
      this.widths.set(key, width_px);
    }
    return width_px;
  }
}

// The place of a name: to the right of the robot, at the map's edge to its left.
export function labelOf(camera, place, text, font, width_px) {
  const gap_px = halfLength_px(camera) + 4;
  const x = camera.toX(place.x_m);
  const y = camera.toY(place.y_m);
  const left = x + gap_px + width_px > camera.width_px ? x - gap_px - width_px : x + gap_px;
  return { place, text, font, left, right: left + width_px, top: y - LABEL_HEIGHT_PX / 2, bottom: y + LABEL_HEIGHT_PX / 2 };
}

// On a ground and without a rim of its letters: to stroke text costs several times as much.
export function write(context, label, colour) {
  context.font = label.font;
  context.fillStyle = `${palette.panel}cc`;
  context.fillRect(label.left - 2, label.top, label.right - label.left + 4, LABEL_HEIGHT_PX);
  context.fillStyle = colour;
  context.fillText(label.text, label.left, label.bottom - 3);
}

export function addOutline(context, camera, place) {
  const size_px = halfLength_px(camera);
  const [sine, cosine] = [Math.sin(place.heading_rad), Math.cos(place.heading_rad)];
  const x = camera.toX(place.x_m);
  const y = camera.toY(place.y_m);
  OUTLINE.forEach(([ahead, left], corner) => {
    const cornerX = x + size_px * (ahead * cosine - left * sine);
    const cornerY = y - size_px * (ahead * sine + left * cosine);
    if (corner === 0) context.moveTo(cornerX, cornerY);
    else context.lineTo(cornerX, cornerY);
  });
  context.closePath();
}

function halfLength_px(camera) {
  return Math.max(SMALLEST_PX, HALF_LENGTH_M * camera.px_per_m);
}

export function covers(one, other) {
  return one.left < other.right && other.left < one.right && one.top < other.bottom && other.top < one.bottom;
}

function isRelative(robot, until_s) {
  const row = robot ? robot.estimates.rowUntil(until_s) : -1;
  return row >= 0 && robot.estimates.columns.is_relative[row] === 1;
}
