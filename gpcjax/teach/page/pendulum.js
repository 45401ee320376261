// The inverted pendulum: cos and sin of the angle (0 is upright, counter-clockwise), angular velocity.

import { drawCurved } from "./arrows.js";
import { colours, font } from "./canvas.js";

/** @returns {import("./scenes.js").Scene["draw"]} */
export function pendulum() {
  return (context, width, height, { obs, action, advice, small }) => {
    const [cos, sin] = obs;
    const rod = Math.min(width * 0.42, height * 0.37);
    const x = width / 2;
    const y = height * (small ? 0.5 : 0.55);
    const thick = Math.max(6, rod * 0.1);

    // Where it shall be held.
    context.strokeStyle = colours.muted;
    context.lineWidth = 1.5;
    context.setLineDash([3, 5]);
    context.beginPath();
    context.arc(x, y - rod, thick * 0.95, 0, 2 * Math.PI);
    context.moveTo(x, y);
    context.lineTo(x, y - rod + thick * 0.95);
    context.stroke();
    context.setLineDash([]);
    if (!small) {
      font(context, 12);
      context.fillStyle = colours.muted;
      context.textAlign = "left";
      context.textBaseline = "middle";
      context.fillText("hold it here", x + thick * 1.4, y - rod - 2);
    }

    context.lineCap = "round";
    context.strokeStyle = colours.body;
    context.lineWidth = thick;
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x - rod * sin, y - rod * cos);
    context.stroke();
    context.fillStyle = colours.body;
    context.beginPath();
    context.arc(x - rod * sin, y - rod * cos, thick * 0.78, 0, 2 * Math.PI);
    context.fill();

    drawCurved(context, { x, y, radius: rod * 0.42, width: Math.max(5, rod * 0.06) }, action[0] ?? 0, advice);

    context.fillStyle = colours.surface;
    context.strokeStyle = colours.ink;
    context.lineWidth = 2;
    context.beginPath();
    context.arc(x, y, thick * 0.42, 0, 2 * Math.PI);
    context.fill();
    context.stroke();
  };
}
