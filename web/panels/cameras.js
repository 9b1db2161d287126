// Cameras whose pictures the station searches: the last picture of each with the tags in it, a few times a second.

import { element, setText } from '../view/dom.js';

const PERIOD_MS = 300;
// The picture is drawn by the browser, the tags above it by this.
const SVG = 'http://www.w3.org/2000/svg';
// A margin below this is poor light.
const LEAST_MARGIN = 10;
const OLD_FROM_S = 1;
// Parts of the picture in which the robot should have been before a camera is calibrated by a drive.
const [COLUMNS, ROWS] = [6, 4];
const ENOUGH_PARTS = 8;

export const cameras = {
  id: 'cameras',
  title: 'Cameras',
  isLive: true,
  isShown: hasCamera,
  build(body) {
    const shown = new Map();
    let asked_ms = -Infinity;
    const ask = async () => {
      const answer = await fetch('v1/cameras', { cache: 'no-store' });
      for (const row of answer.ok ? await answer.json() : []) {
        if (!shown.has(row.link)) shown.set(row.link, new CameraFigure(row, body));
        await shown.get(row.link).show(row);
      }
    };
    return {
      // The last answer is waited for before the next question.
      draw(view) {
        const now_ms = performance.now();
        if (!hasCamera(view) || view.stalled_s > 0 || now_ms - asked_ms < PERIOD_MS || document.hidden) return;
        asked_ms = Infinity;
        // The connection's own line says when the station is away.
        ask().catch(() => {}).finally(() => { asked_ms = performance.now(); });
      },
    };
  },
};

function hasCamera({ isReplay, session }) {
  return !isReplay && session.links.some((link) => String(link.name).startsWith('camera:'));
}

class CameraFigure {
  #last = null;

  constructor({ link, name, is_calibrated, floor_tags }, body) {
    this.link = link;
    this.steps = is_calibrated ? null : new CalibrationSteps(floor_tags);
    this.image = element('img', { alt: `Picture of the camera ${name}` });
    this.overlay = document.createElementNS(SVG, 'svg');
    this.overlay.setAttribute('aria-hidden', 'true');
    this.state = element('p', { class: 'figure' });
    this.tags = element('p', { class: 'note' });
    body.append(element('figure', { class: 'camera' },
      element('figcaption', { text: name }), element('div', { class: 'picture' }, this.image, this.overlay), this.state, this.tags,
      ...(this.steps ? [this.steps.list] : [])));
  }

  async show({ picture }) {
    if (!picture) {
      setText(this.state, 'no picture yet');
      return;
    }
    const at_s = performance.now() / 1000 - picture.age_s;
    const rate_hz = this.#last && at_s > this.#last.at_s ? (picture.number - this.#last.number) / (at_s - this.#last.at_s) : 0;
    if (this.#last?.number !== picture.number) {
      this.image.src = `v1/cameras/${this.link}/picture?number=${picture.number}`;
      // A picture that the browser cannot show is no reason to stop.
      await this.image.decode().catch(() => {});
      this.#drawTags(picture);
    }
    setText(this.state, [
      `${picture.width} x ${picture.height}`, `${rate_hz.toFixed(1)} pictures/s`, `searched after ${(1000 * picture.latency_s).toFixed(0)} ms`,
      `${picture.dropped} dropped`, `${picture.damaged} damaged`,
    ].join(', '));
    this.state.classList.toggle('stale', picture.age_s > OLD_FROM_S);
    const poor = picture.tags.filter((tag) => tag.margin < LEAST_MARGIN);
    const ids = picture.tags.map((tag) => tag.id).join(', ');
    const light = poor.length > 0 ? '; more light: black and white are hardly apart' : '';
    setText(this.tags, picture.tags.length > 0 ? `tags ${ids}${light}` : 'no tag: is one wholly in the picture, flat, and with white around it?');
    this.#last = { number: picture.number, at_s };
    this.steps?.show(picture);
  }

  #drawTags({ width, height, tags }) {
    // The centre of the first pixel is at 0, 0.
    this.overlay.setAttribute('viewBox', `-0.5 -0.5 ${width} ${height}`);
    this.overlay.replaceChildren(...this.steps?.visitedParts(width, height) ?? [], ...tags.flatMap((tag) => {
      const outline = document.createElementNS(SVG, 'polygon');
      outline.setAttribute('points', tag.corners.map((corner) => corner.join(',')).join(' '));
      const id = document.createElementNS(SVG, 'text');
      const middle = [0, 1].map((axis) => tag.corners.reduce((sum, corner) => sum + corner[axis], 0) / 4);
      id.setAttribute('x', middle[0]);
      id.setAttribute('y', middle[1]);
      // No larger than the tag, or neighbours cover each other.
      const side = Math.hypot(tag.corners[1][0] - tag.corners[0][0], tag.corners[1][1] - tag.corners[0][1]);
      id.setAttribute('font-size', Math.min(width / 40, Math.max(width / 90, side / 2)));
      id.textContent = String(tag.id);
      return [outline, id];
    }));
  }
}

// What is left to do until a camera can be calibrated by a drive, and where in the picture the robot has been.
class CalibrationSteps {
  #floorTags = new Set();
  #parts = new Set();

  constructor([first, last]) {
    this.floor = { first, last };
    this.items = [0, 1, 2, 3].map(() => element('li'));
    this.list = element('ol', { class: 'steps', 'aria-label': 'Calibration' }, ...this.items);
  }

  show({ width, height, tags }) {
    const { first, last } = this.floor;
    const isOnFloor = (tag) => tag.id >= first && tag.id <= last;
    for (const tag of tags) {
      if (isOnFloor(tag)) this.#floorTags.add(tag.id);
      else this.#parts.add(partOf(tag, width, height));
    }
    const sheet = last - first + 1;
    this.#set(0, this.#floorTags.size > 0, `Lay the floor sheet in the picture, and leave it there: ${this.#floorTags.size} of ${sheet} tags seen`);
    this.#set(1, this.#parts.size > 0, 'Put the robot with its tag at the origin, looking along x');
    this.#set(2, this.#parts.size >= ENOUGH_PARTS,
      `Drive for a minute, with turns, through all of the floor: the tag was in ${this.#parts.size} of ${COLUMNS * ROWS} parts of the picture`);
    this.#set(3, false, 'Stop this run, and: posebridge camera calibrate --drive RECORDING --sheet-at X,Y,DEG --out camera.toml');
  }

  #set(index, isDone, text) {
    setText(this.items[index], text);
    this.items[index].classList.toggle('done', isDone);
  }

  visitedParts(width, height) {
    return [...this.#parts].map((part) => {
      const visited = document.createElementNS(SVG, 'rect');
      visited.setAttribute('x', (part % COLUMNS) * width / COLUMNS - 0.5);
      visited.setAttribute('y', Math.floor(part / COLUMNS) * height / ROWS - 0.5);
      visited.setAttribute('width', width / COLUMNS);
      visited.setAttribute('height', height / ROWS);
      return visited;
    });
  }
}

function partOf({ corners }, width, height) {
  const middle = (axis, size) => Math.min(0.999, Math.max(0, corners.reduce((sum, corner) => sum + corner[axis], 0) / 4 / size));
  return Math.floor(middle(0, width) * COLUMNS) + COLUMNS * Math.floor(middle(1, height) * ROWS);
}
