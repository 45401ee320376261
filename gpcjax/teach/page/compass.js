// The action in the corner of a scene that does not draw it by itself: an arrow to the side and one up or down.

import { tone } from "./arrows.js";
import { colours } from "./canvas.js";

const WAY = { left: [-1, 0], right: [1, 0], up: [0, -1], down: [0, 1] };

/**
 * @param {CanvasRenderingContext2D} context @param {number} width @param {number} height @param {any} task
 * @param {import("./scenes.js").View} view
 */
export function drawCompass(context, width, height, task, { action, advice }) {
  const keyed = task.actions.map((each, dim) => [dim, WAY[each.more.key]]).filter(([, way]) => way);
  if (!keyed.length || task.actions.length > 2) return;
  const radius = Math.min(46, width * 0.12, height * 0.14);
  const [x, y] = [width - radius - 16, height - radius - 16];
  context.globalAlpha = 0.86;
  context.fillStyle = colours.surface;
  context.beginPath();
  context.arc(x, y, radius + 6, 0, 2 * Math.PI);
  context.fill();
  context.globalAlpha = 1;
  context.lineCap = "round";
  for (const [dim, [dx, dy]] of keyed) {
    const line = (from, to, wide, colour) => {
      context.strokeStyle = colour;
      context.lineWidth = wide;
      context.beginPath();
      context.moveTo(x + dx * from * radius, y + dy * from * radius);
      context.lineTo(x + dx * to * radius, y + dy * to * radius);
      context.stroke();
    };
    const value = Math.max(-1, Math.min(1, action[dim] ?? 0));
    line(-1, 1, 2, colours.line);
    if (Math.abs(value) > 0.01) line(0, value, 8, tone(value));
    if (advice && advice.dim === dim) {
      context.globalAlpha = advice.strength;
      line(advice.before, advice.after, 3, colours.ink);
      context.globalAlpha = 1;
    }
  }
  context.fillStyle = colours.ink;
  context.beginPath();
  context.arc(x, y, 3, 0, 2 * Math.PI);
  context.fill();
}
