// Where the robot is, shown by a person: press on the map where it stands, drag to where it looks, let go.

import { palette } from './palette.js';

/** How well a person places a robot on the map, and on the floor. */
export const BY_EYE = Object.freeze({ position_sigma_m: 0.05, heading_sigma_rad: (10 * Math.PI) / 180 });

// A shorter drag has no direction.
const SHORTEST_PX = 12;
const HEAD_PX = 9;

export class PoseInput {
  /** Calls `onPose({ x_m, y_m, heading_rad })` when a pose was dragged, `onMove()` while one is, and `onEnd()` when nothing more is asked for. */
  constructor(canvas, camera, { onPose, onMove, onEnd }) {
    this.camera = camera;
    this.canvas = canvas;
    this.isAsking = false;
    this.from = null;
    this.to = null;
    this.onEnd = onEnd;
    // These come before those that move the map, and keep the events from them.
    const listen = (name, act) => canvas.addEventListener(name, (event) => {
      if (!this.isAsking) return;
      event.stopImmediatePropagation();
      act(event);
    }, { capture: true });
    listen('pointerdown', (event) => {
      if (!event.isPrimary || event.button !== 0) return;
      canvas.setPointerCapture(event.pointerId);
      this.to = place(event);
      // On the floor: the map may move on below the pointer.
      this.from = camera.toArena(this.to.x_px, this.to.y_px);
      onMove();
    });
    listen('pointermove', (event) => {
      if (!this.from || !event.isPrimary) return;
      this.to = place(event);
      onMove();
    });
    listen('pointerup', (event) => {
      if (!this.from || !event.isPrimary) return;
      this.to = place(event);
      const pose = this.#pose();
      if (pose) onPose(pose);
      this.stop();
    });
    listen('pointercancel', () => this.stop());
    canvas.ownerDocument.addEventListener('keydown', (event) => {
      if (this.isAsking && event.key === 'Escape') this.stop();
    });
  }

  start() {
    this.isAsking = true;
    this.canvas.classList.add('asks-pose');
  }

  stop() {
    this.isAsking = false;
    this.from = null;
    this.canvas.classList.remove('asks-pose');
    this.onEnd();
  }

  draw(context) {
    if (!this.from) return;
    const { to } = this;
    const from = this.#fromOnMap();
    const angle = Math.atan2(to.y_px - from.y_px, to.x_px - from.x_px);
    context.strokeStyle = palette.estimate;
    context.lineWidth = 3;
    context.beginPath();
    context.arc(from.x_px, from.y_px, 4, 0, 2 * Math.PI);
    context.moveTo(from.x_px, from.y_px);
    context.lineTo(to.x_px, to.y_px);
    for (const side of [-0.4, 0.4]) {
      context.moveTo(to.x_px, to.y_px);
      context.lineTo(to.x_px - HEAD_PX * Math.cos(angle + side), to.y_px - HEAD_PX * Math.sin(angle + side));
    }
    context.stroke();
  }

  #fromOnMap() {
    return { x_px: this.camera.toX(this.from.x_m), y_px: this.camera.toY(this.from.y_m) };
  }

  #pose() {
    const onMap = this.#fromOnMap();
    if (Math.hypot(this.to.x_px - onMap.x_px, this.to.y_px - onMap.y_px) < SHORTEST_PX) return null;
    const { from } = this;
    const to = this.camera.toArena(this.to.x_px, this.to.y_px);
    return { x_m: from.x_m, y_m: from.y_m, heading_rad: Math.atan2(to.y_m - from.y_m, to.x_m - from.x_m) };
  }
}

function place(event) {
  return { x_px: event.offsetX, y_px: event.offsetY };
}
