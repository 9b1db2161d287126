// The robots that other stations of the fleet own, on the map: an outline and a name each, lighter than those of this station.

import { silence_s } from '../model/silence.js';
import { addOutline, covers, labelOf, SILENT_DASH, write } from './other_robots.js';
import { palette } from './palette.js';

const ALPHA = 0.5;
const MOST_LABELS = 64;
const FONT = '12px system-ui, sans-serif';

export class FleetRobots {
  constructor() {
    /** Of each robot where it is on the map. */
    this.places = [];
    this.labels = [];
  }

  /** Finds where they are; a robot that this station hears as well is drawn by its own estimate as long as there is one. */
  read({ fleet, session, until_s }) {
    this.places = (fleet?.robots ?? []).filter((robot) => fleet.isElsewhere(robot) && isInArena(robot) && !isHeard(session, robot, until_s)).map((robot) => ({
      name: robot.name.slice(0, 64), x_m: robot.estimate.x_m, y_m: robot.estimate.y_m, heading_rad: robot.estimate.heading_rad ?? 0, isSilent: fleet.isSilent(robot),
    }));
  }

  /** Adds where they are to a box. */
  addTo(box) {
    for (const { x_m, y_m } of this.places) box.add(x_m, y_m);
  }

  draw(context, camera) {
    if (this.places.length === 0) return;
    context.globalAlpha = ALPHA;
    context.fillStyle = palette.panel;
    context.strokeStyle = palette.other;
    context.lineWidth = 1.2;
    for (const isSilent of [false, true]) {
      context.setLineDash(isSilent ? SILENT_DASH : []);
      context.beginPath();
      for (const place of this.places) if (place.isSilent === isSilent) addOutline(context, camera, place);
      context.fill();
      context.stroke();
    }
    context.setLineDash([]);
    // A name has to be read.
    context.globalAlpha = 1;
    this.labels.length = 0;
    for (const place of this.places) {
      if (this.labels.length >= MOST_LABELS) break;
      context.font = FONT;
      const label = labelOf(camera, place, place.name, FONT, context.measureText(place.name).width);
      if (this.labels.some((other) => covers(label, other))) continue;
      this.labels.push(label);
      write(context, label, palette.other);
    }
  }
}

function isInArena({ estimate }) {
  return Boolean(estimate?.is_position_valid) && Number.isFinite(estimate.x_m) && Number.isFinite(estimate.y_m);
}

function isHeard(session, { robot: id }, until_s) {
  const own = id ? session.robots.get(id) : undefined;
  return own !== undefined && own.estimates.length > 0 && silence_s(own.estimates, until_s) === 0;
}
