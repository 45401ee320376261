// Cart-pole: place, speed, angle of the pole (0 upright, positive to the right), its angular velocity.

import { drawStraight } from "./arrows.js";
import { colours, font } from "./canvas.js";
import { fixed, rangeOf } from "./format.js";

/** Metres, of gymnasium's cart-pole. */
const POLE = 1.0;

/** @param {any} task @returns {import("./scenes.js").Scene["draw"]} */
export function cartpole(task) {
  const far = rangeOf(task.observations[0])?.[1] ?? 2.4;
  const lean = rangeOf(task.observations[2])?.[1] ?? 0.2094;
  return (context, width, height, { obs, action, advice, small }) => {
    const scale = Math.min(width / (2 * far + 0.9), (height * 0.72) / (POLE + 0.35));
    const ground = Math.min(height * 0.78, height - (small ? 14 : 58));
    const centre = width / 2;
    const x = centre + obs[0] * scale;
    const cart = { width: 0.46 * scale, height: 0.25 * scale };
    const wheel = 0.06 * scale;
    const pivot = ground - wheel * 1.4 - cart.height;

    track(context, { centre, ground, scale, far, small });

    // Beyond these the pole has fallen.
    context.strokeStyle = colours.muted;
    context.lineWidth = 1.2;
    context.setLineDash([3, 5]);
    context.beginPath();
    for (const side of [-lean, lean]) {
      context.moveTo(x + 0.35 * POLE * scale * Math.sin(side), pivot - 0.35 * POLE * scale * Math.cos(side));
      context.lineTo(x + 1.08 * POLE * scale * Math.sin(side), pivot - 1.08 * POLE * scale * Math.cos(side));
    }
    context.stroke();
    context.setLineDash([]);

    context.fillStyle = colours.body;
    context.beginPath();
    context.roundRect(x - cart.width / 2, pivot, cart.width, cart.height, 0.045 * scale);
    context.fill();
    context.fillStyle = colours.ink;
    for (const side of [-0.3, 0.3]) {
      context.beginPath();
      context.arc(x + side * cart.width, ground - wheel, wheel, 0, 2 * Math.PI);
      context.fill();
    }

    const tip = [x + POLE * scale * Math.sin(obs[2]), pivot - POLE * scale * Math.cos(obs[2])];
    const near = Math.min(1, Math.abs(obs[2]) / lean);
    context.lineCap = "round";
    context.strokeStyle = near > 0.75 ? colours.more : colours.ink;
    context.lineWidth = 0.07 * scale;
    context.beginPath();
    context.moveTo(x, pivot);
    context.lineTo(tip[0], tip[1]);
    context.stroke();
    context.fillStyle = colours.surface;
    context.beginPath();
    context.arc(x, pivot, 0.028 * scale, 0, 2 * Math.PI);
    context.fill();

    const place = { x, y: pivot + cart.height / 2, full: 0.8 * scale, gap: cart.width / 2 + 6, width: Math.max(6, 0.085 * scale) };
    drawStraight(context, place, action[0] ?? 0, advice);
  };
}

/** The track with its ends. @param {CanvasRenderingContext2D} context */
function track(context, { centre, ground, scale, far, small }) {
  context.strokeStyle = colours.line;
  context.lineWidth = 3;
  context.lineCap = "round";
  context.beginPath();
  context.moveTo(centre - far * scale, ground + 1.5);
  context.lineTo(centre + far * scale, ground + 1.5);
  context.stroke();
  context.strokeStyle = colours.muted;
  context.beginPath();
  for (const side of [-far, far]) {
    context.moveTo(centre + side * scale, ground + 1.5);
    context.lineTo(centre + side * scale, ground - 0.16 * scale);
  }
  context.stroke();
  if (small) return;
  font(context, 12);
  context.fillStyle = colours.muted;
  context.textBaseline = "top";
  context.textAlign = "center";
  for (const metre of [-far, -1, 0, 1, far]) {
    const digits = Number.isInteger(metre) ? 0 : 1;
    context.fillText(metre === 0 ? "0 m" : fixed(metre, digits), centre + metre * scale, ground + 10);
  }
}
