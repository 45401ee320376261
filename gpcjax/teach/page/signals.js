// A task without a scene: each number of the observation as a line of the last seconds, with a bar of its value.

import { colours, font } from "./canvas.js";
import { decimals, fixed, rangeOf } from "./format.js";

const KEPT = 400;

export class Signals {
  /** @param {any} task */
  constructor(task) {
    this.task = task;
    this.size = task.observations.length;
    this.kept = new Float32Array(KEPT * this.size);
    this.next = 0;
    this.count = 0;
    this.ranges = task.observations.map((seen) => rangeOf(seen));
    /** Of numbers without bounds: what was seen so far. */
    this.seen = task.observations.map(() => [Infinity, -Infinity]);
  }

  clear() {
    this.next = this.count = 0;
  }

  /** @param {number[]} obs */
  push(obs) {
    this.kept.set(obs.slice(0, this.size), this.next * this.size);
    this.next = (this.next + 1) % KEPT;
    this.count = Math.min(KEPT, this.count + 1);
    for (let k = 0; k < this.size; k++) {
      if (obs[k] < this.seen[k][0]) this.seen[k][0] = obs[k];
      if (obs[k] > this.seen[k][1]) this.seen[k][1] = obs[k];
    }
  }

  /** @param {number} k */
  rangeOf(k) {
    if (this.ranges[k]) return this.ranges[k];
    const [low, high] = this.seen[k];
    return low < high ? [low, high] : [low - 1, low + 1];
  }

  /** @type {import("./scenes.js").Scene["draw"]} */
  draw(context, width, height, view) {
    const edge = view.small ? 6 : 16;
    // Beneath them, room for the word of how sure the policy is.
    const row = (height - edge - (view.small ? edge : 44)) / this.size;
    const text = Math.max(9, Math.min(13, row * 0.4));
    const names = view.small ? 0 : Math.min(150, width * 0.3);
    const values = view.small ? 0 : Math.min(90, width * 0.2);
    const left = edge + names;
    const long = width - edge - values - left;
    for (let k = 0; k < this.size; k++) {
      const top = edge + k * row + row * 0.1;
      const high = row * 0.8;
      this.line(context, k, left, top, long, high);
      if (view.small) continue;
      font(context, text);
      context.textBaseline = "middle";
      context.fillStyle = colours.muted;
      context.textAlign = "left";
      context.fillText(this.task.observations[k].name, edge, top + high / 2, names - 10);
      context.fillStyle = colours.ink;
      const [from, to] = this.rangeOf(k);
      context.fillText(fixed(view.obs[k], decimals(to - from) - 1), left + long + 14, top + high / 2, values - 14);
    }
  }

  /** @param {CanvasRenderingContext2D} context */
  line(context, k, left, top, long, high) {
    const [low, up] = this.rangeOf(k);
    const y = (value) => top + high * (1 - Math.max(0, Math.min(1, (value - low) / (up - low))));
    context.fillStyle = colours.faint;
    context.fillRect(left, top, long, high);
    if (low < 0 && up > 0) {
      context.fillStyle = colours.line;
      context.fillRect(left, y(0), long, 1);
    }
    if (!this.count) return;
    context.strokeStyle = colours.body;
    context.lineWidth = 1.8;
    context.lineJoin = "round";
    context.beginPath();
    let last = 0;
    for (let step = 0; step < this.count; step++) {
      const at = (this.next - this.count + step + KEPT) % KEPT;
      last = y(this.kept[at * this.size + k]);
      context.lineTo(left + (long * (KEPT - this.count + step)) / (KEPT - 1), last);
    }
    context.stroke();
    context.fillStyle = colours.ink;
    context.beginPath();
    context.arc(left + long, last, 3.5, 0, 2 * Math.PI);
    context.fill();
  }
}
