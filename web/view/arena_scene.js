// What stands on the map, drawn on a canvas: grid, path, trails, fixes, robots, ellipse and heading cone.

import { roundUp, translucent } from './chart.js';
import { DASHES, markColour, palette } from './palette.js';
import { MARKS } from '../model/marks.js';

// Half the length of the drawn robot: a LEGO robot is about 16 cm long.
const ROBOT_M = 0.08;
const SMALLEST_ROBOT_PX = 7;
// The cone shows two standard deviations to each side, as ellipses hold 95 in 100.
const CONE_SIGMAS = 2;
const FIXES_S = 20;
// Above stands the toolbar.
const LABELS_FROM_PX = 56;
// Points of a trail nearer than this to the last drawn one add nothing.
const SHORTEST_STEP_PX = 1.5;

export function drawGrid(context, camera) {
  const step_m = roundUp(70 / camera.px_per_m);
  const least = camera.toArena(0, camera.height_px);
  const most = camera.toArena(camera.width_px, 0);
  context.lineWidth = 1;
  context.strokeStyle = palette.grid;
  context.fillStyle = palette.faint;
  context.font = '11px system-ui, sans-serif';
  context.beginPath();
  for (let line = Math.ceil(least.x_m / step_m); line * step_m <= most.x_m; line += 1) {
    const x = Math.round(camera.toX(line * step_m)) + 0.5;
    context.moveTo(x, 0);
    context.lineTo(x, camera.height_px);
    context.fillText(gridLabel(line * step_m, step_m), x + 3, camera.height_px - 5);
  }
  for (let line = Math.ceil(least.y_m / step_m); line * step_m <= most.y_m; line += 1) {
    const y = Math.round(camera.toY(line * step_m)) + 0.5;
    context.moveTo(0, y);
    context.lineTo(camera.width_px, y);
    if (y > LABELS_FROM_PX) context.fillText(gridLabel(line * step_m, step_m), 4, y - 3);
  }
  context.stroke();
}

function gridLabel(value_m, step_m) {
  return step_m >= 0.1 ? `${value_m.toFixed(1)} m` : `${(1000 * value_m).toFixed(0)} mm`;
}

export function drawPath(context, camera, path) {
  if (path.length === 0) return;
  context.beginPath();
  for (const [x_m, y_m] of path) context.lineTo(camera.toX(x_m), camera.toY(y_m));
  stroke(context, palette.path, 1.5, DASHES.path);
}

const WALL_PX = 3;
const PLACE_PX = 5;

/** What stands in the arena: walls as lines, landmarks as triangles, beacons as rings, with their numbers. */
export function drawArena(context, camera, { walls, landmarks, beacons }) {
  context.beginPath();
  for (const [from, to] of walls) {
    context.moveTo(camera.toX(from[0]), camera.toY(from[1]));
    context.lineTo(camera.toX(to[0]), camera.toY(to[1]));
  }
  stroke(context, palette.wall, WALL_PX, []);
  context.font = '11px system-ui, sans-serif';
  for (const [draw, places] of [[drawLandmark, landmarks], [drawBeacon, beacons]]) {
    for (const { id, x_m, y_m } of places) {
      const [x, y] = [camera.toX(x_m), camera.toY(y_m)];
      draw(context, x, y);
      context.fillStyle = palette.place;
      context.fillText(String(id), x + PLACE_PX + 3, y + 4);
    }
  }
}

export function drawWall(context, x, y) {
  context.beginPath();
  context.moveTo(x - 2 * PLACE_PX, y);
  context.lineTo(x + 2 * PLACE_PX, y);
  stroke(context, palette.wall, WALL_PX, []);
}

export function drawLandmark(context, x, y) {
  context.fillStyle = palette.place;
  context.beginPath();
  polygon(context, x, y, 1.2 * PLACE_PX, 3, -Math.PI / 2);
  context.fill();
}

export function drawBeacon(context, x, y) {
  context.beginPath();
  context.arc(x, y, PLACE_PX, 0, 2 * Math.PI);
  context.moveTo(x + 1, y);
  context.arc(x, y, 1, 0, 2 * Math.PI);
  stroke(context, palette.place, 1.6, []);
}

/** Rows `from` to `to` of a track, by the names of its columns. */
export function drawTrail(context, camera, trail, from, to) {
  const xs = trail.track.columns[trail.x];
  const ys = trail.track.columns[trail.y];
  let lastX = Infinity;
  let lastY = Infinity;
  context.beginPath();
  for (let row = from; row < to; row += 1) {
    const x = camera.toX(xs[row]);
    const y = camera.toY(ys[row]);
    if (Math.abs(x - lastX) + Math.abs(y - lastY) < SHORTEST_STEP_PX || Number.isNaN(x + y)) continue;
    // A leap is no drive: the estimate was reset, or the robot lifted.
    if (Math.hypot(x - lastX, y - lastY) > 0.15 * camera.px_per_m) context.moveTo(x, y);
    else context.lineTo(x, y);
    lastX = x;
    lastY = y;
  }
  stroke(context, trail.stroke ?? palette[trail.colour], trail.width, trail.dash ?? DASHES[trail.colour]);
}

function stroke(context, colour, width, dash) {
  context.setLineDash(dash);
  context.lineJoin = 'round';
  context.lineWidth = width;
  context.strokeStyle = colour;
  context.stroke();
  context.setLineDash([]);
}

/** Fixes of the last seconds, older ones fainter. */
export function drawFixes(context, camera, fixes, until_s, window_s = FIXES_S) {
  const { t_s, x_m, y_m, mark } = fixes.columns;
  const to = fixes.rowAfter(until_s);
  for (let row = fixes.rowAt(until_s - window_s); row < to; row += 1) {
    context.globalAlpha = 1 - 0.8 * ((until_s - t_s[row]) / window_s);
    drawMark(context, mark[row], camera.toX(x_m[row]), camera.toY(y_m[row]), 3.6);
  }
  context.globalAlpha = 1;
}

/** The mark of a fix: a dot accepted, a diamond late, a cross gated, a square too old, a star taken as the new pose. */
export function drawMark(context, mark, x, y, radius) {
  context.strokeStyle = markColour(mark);
  context.fillStyle = markColour(mark);
  context.lineWidth = 1.6;
  context.beginPath();
  if (mark === MARKS.accepted) {
    context.arc(x, y, 0.75 * radius, 0, 2 * Math.PI);
    context.fill();
    return;
  }
  if (mark === MARKS.late) polygon(context, x, y, 1.15 * radius, 4, 0);
  else if (mark === MARKS.tooOld) polygon(context, x, y, 1.25 * radius, 4, Math.PI / 4);
  else if (mark === MARKS.resetTo) spokes(context, x, y, 1.6 * radius, 8);
  else spokes(context, x, y, 1.3 * radius, 4);
  context.stroke();
}

function polygon(context, x, y, radius, corners, turn_rad) {
  for (let corner = 0; corner < corners; corner += 1) {
    const angle = turn_rad + (2 * Math.PI * corner) / corners;
    context.lineTo(x + radius * Math.cos(angle), y + radius * Math.sin(angle));
  }
  context.closePath();
}

function spokes(context, x, y, radius, count) {
  for (let spoke = 0; spoke < count; spoke += 1) {
    const angle = Math.PI / 4 + (2 * Math.PI * spoke) / count;
    context.moveTo(x, y);
    context.lineTo(x + radius * Math.cos(angle), y + radius * Math.sin(angle));
  }
}

/** A robot from above, nose along its heading. */
export function drawRobot(context, camera, pose, look) {
  if (Number.isNaN(pose.x_m + pose.y_m)) return;
  const size = Math.max(SMALLEST_ROBOT_PX, ROBOT_M * camera.px_per_m);
  context.save();
  context.translate(camera.toX(pose.x_m), camera.toY(pose.y_m));
  context.rotate(-(pose.heading_rad || 0));
  context.beginPath();
  context.moveTo(size, 0);
  context.lineTo(0.35 * size, 0.62 * size);
  context.lineTo(-0.75 * size, 0.62 * size);
  context.lineTo(-0.75 * size, -0.62 * size);
  context.lineTo(0.35 * size, -0.62 * size);
  context.closePath();
  if (look.isFilled) {
    context.fillStyle = translucent(palette[look.colour]);
    context.fill();
  }
  stroke(context, palette[look.colour], look.width, look.dash ?? []);
  context.restore();
}

/** The ellipse that holds the position in 95 of 100 cases; semi-axes in metres, direction of the major one in the arena. */
export function drawEllipse(context, camera, estimate) {
  const { x_m, y_m, major_m, minor_m, axis_rad } = estimate;
  if (Number.isNaN(x_m + y_m + major_m + minor_m + axis_rad)) return;
  const scale = camera.px_per_m;
  context.beginPath();
  context.ellipse(camera.toX(x_m), camera.toY(y_m), Math.abs(major_m) * scale, Math.abs(minor_m) * scale, -axis_rad, 0, 2 * Math.PI);
  context.fillStyle = translucent(palette.ellipse);
  context.fill();
  stroke(context, palette.ellipse, 1.6, []);
}

/** Where the robot may be heading: two sigma to each side. */
export function drawCone(context, camera, estimate) {
  const { x_m, y_m, heading_rad, heading_sigma_rad } = estimate;
  if (Number.isNaN(x_m + y_m + heading_rad + heading_sigma_rad)) return;
  const length = Math.max(34, 0.3 * camera.px_per_m);
  const half_rad = Math.min(Math.PI, CONE_SIGMAS * heading_sigma_rad);
  const x = camera.toX(x_m);
  const y = camera.toY(y_m);
  context.beginPath();
  context.moveTo(x, y);
  context.arc(x, y, length, -heading_rad - half_rad, -heading_rad + half_rad);
  context.closePath();
  context.fillStyle = translucent(palette.estimate);
  context.fill();
  stroke(context, palette.estimate, 1, []);
}
