// The panels, in the order in which they stand on the page. To add one: a file beside this one and a line here.

import { arena } from './arena.js';
import { calibration } from './calibration.js';
import { cameras } from './cameras.js';
import { comparison } from './comparison.js';
import { error } from './error.js';
import { fleet } from './fleet.js';
import { innovations } from './innovations.js';
import { links } from './links.js';
import { log } from './log.js';
import { parameters } from './parameters.js';
import { quantity, thermometers } from './quantities.js';
import { recordings } from './recordings.js';
import { robots } from './robots.js';
import { setup } from './setup.js';
import { simulator } from './simulator.js';

/**
 * `build(body, station)` fills a panel and gives `{draw(view), recolour?()}`. `isAnimated` ones are drawn with every frame of the screen,
 * the others in turn, one a frame. `isLive` ones act on the live robot and rest while a recording is shown; `rest?()` is called then, and before
 * another robot is chosen. `isOfRobot` ones show the chosen robot and bear its name. `isShown?(view)` says whether a panel is there at all.
 */
export const PANELS = [
  setup, robots, arena, fleet, cameras, quantity, simulator, error, comparison, thermometers, innovations, calibration, parameters, links, log, recordings,
];
