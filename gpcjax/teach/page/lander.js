// The lunar lander, from its observation alone: place, height, speeds, angle (counter-clockwise), turning, which legs touch.
// The hills beside the pad are no part of an observation, so they are not drawn.

import { colours, font } from "./canvas.js";
import { drawCompass } from "./compass.js";

/** Of gymnasium's lander, in its units of length: the view, the pad, the body, its legs. */
const VIEW = { wide: 20, high: 40 / 3, ground: 10 / 3 };
const PAD = 2;
const BODY = [[-14, -17], [-17, 0], [-17, 10], [17, 10], [17, 0], [14, -17]].map(([x, y]) => [x / 30, y / 30]);
const LEG = { out: 20 / 30, down: 18 / 30 };
/** From where on the side engines fire; the main one does above zero. */
const SIDE_FROM = 0.5;

/** @param {any} task @returns {import("./scenes.js").Scene["draw"]} */
export function lander(task) {
  return (context, width, height, view) => {
    const { obs, action, small } = view;
    const scale = Math.min(width / VIEW.wide, height / VIEW.high);
    const centre = width / 2;
    const ground = Math.min(height - VIEW.ground * scale, height - 20);
    pad(context, { width, height, centre, ground, scale, small });
    context.save();
    // The centre of a lander that stands is as high above the ground as its legs are long.
    context.translate(centre + obs[0] * (VIEW.wide / 2) * scale, ground - (LEG.down + obs[1] * (VIEW.high / 2)) * scale);
    context.rotate(-obs[4]);
    context.scale(scale, scale);
    flames(context, action);
    body(context, obs);
    context.restore();
    if (!small) drawCompass(context, width, height, task, view);
  };
}

/** @param {CanvasRenderingContext2D} context */
function pad(context, { width, height, centre, ground, scale, small }) {
  context.fillStyle = colours.faint;
  context.fillRect(0, ground, width, height - ground);
  context.strokeStyle = colours.line;
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(0, ground);
  context.lineTo(width, ground);
  context.stroke();
  context.strokeStyle = context.fillStyle = colours.ink;
  context.lineWidth = 4;
  context.beginPath();
  context.moveTo(centre - PAD * scale, ground);
  context.lineTo(centre + PAD * scale, ground);
  context.stroke();
  context.lineWidth = 1.5;
  for (const side of [-PAD, PAD]) {
    const x = centre + side * scale;
    const top = ground - 1.6 * scale;
    context.beginPath();
    context.moveTo(x, ground);
    context.lineTo(x, top);
    context.stroke();
    context.fillStyle = colours.more;
    context.beginPath();
    context.moveTo(x, top);
    context.lineTo(x + 0.8 * scale, top + 0.3 * scale);
    context.lineTo(x, top + 0.6 * scale);
    context.fill();
  }
  if (small) return;
  font(context, 12);
  context.fillStyle = colours.muted;
  context.textAlign = "center";
  context.textBaseline = "top";
  context.fillText("land between the flags; hills beside them are not drawn", centre, ground + 8);
}

/** @param {CanvasRenderingContext2D} context @param {number[]} obs */
function body(context, obs) {
  context.lineCap = context.lineJoin = "round";
  for (const [side, touches] of [[-1, obs[6]], [1, obs[7]]]) {
    context.strokeStyle = touches > 0.5 ? colours.run : colours.muted;
    context.lineWidth = 0.13;
    context.beginPath();
    context.moveTo(side * 0.4, 0.25);
    context.lineTo(side * LEG.out, LEG.down);
    context.moveTo(side * (LEG.out - 0.16), LEG.down);
    context.lineTo(side * (LEG.out + 0.16), LEG.down);
    context.stroke();
  }
  context.fillStyle = colours.body;
  context.beginPath();
  for (const [x, y] of BODY) context.lineTo(x, y);
  context.fill();
}

/** Engines that fire now: as strong as they do. @param {CanvasRenderingContext2D} context @param {number[]} action */
function flames(context, [main = 0, side = 0]) {
  context.fillStyle = colours.more;
  const flame = (points) => {
    context.beginPath();
    for (const [x, y] of points) context.lineTo(x, y);
    context.fill();
  };
  if (main > 0) flame([[-0.22, 0.33], [0.22, 0.33], [0, 0.75 + Math.min(1, main)]]);
  if (Math.abs(side) > SIDE_FROM) {
    // The left engine fires below zero, and blows to the left.
    const way = Math.sign(side);
    flame([[way * 0.5, -0.4], [way * 0.5, -0.15], [way * (0.7 + 0.7 * Math.min(1, Math.abs(side))), -0.28]]);
  }
}
