// What is drawn of a task: by its own scene where there is one, else pictures, else each number as a signal.

import { cartpole } from "./cartpole.js";
import { lander } from "./lander.js";
import { mountaincar } from "./mountaincar.js";
import { pendulum } from "./pendulum.js";
import { Pictures } from "./pictures.js";
import { Signals } from "./signals.js";

/**
 * What the last advice did, while it is shown. `strength` fades from 1 to 0.
 * @typedef {{dim: number, h: number, before: number, after: number, strength: number}} Advice
 *
 * What there is to draw. `small` leaves out what would not be read in an inset.
 * @typedef {{obs: number[], action: number[], advice: Advice|null, small: boolean}} View
 *
 * @typedef {object} Scene
 * @property {(context: CanvasRenderingContext2D, width: number, height: number, view: View) => void} draw
 * @property {(obs: number[], action: number[]) => void} [push] takes a step, where a scene shows those before
 * @property {() => void} [clear] another episode begins
 * @property {(image: Blob) => void} [picture]
 */

const DRAWN = { cartpole, lander, mountaincar, pendulum };

/** @param {any} task @param {() => void} changed a picture is there @returns {Scene} */
export function makeScene(task, changed) {
  if (task.scene === "pictures") return new Pictures(task, changed);
  const drawn = DRAWN[task.scene];
  return drawn ? { draw: drawn(task) } : new Signals(task);
}
