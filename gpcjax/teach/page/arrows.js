// An action as an arrow, straight or around a pivot, and what the last advice did to it.

import { colours, font } from "./canvas.js";
import { fixed } from "./format.js";

/** The colour of an action: less is blue, more is orange, here and in the map. @param {number} value */
export const tone = (value) => (value < 0 ? colours.less : colours.more);

/** A head at (x, y) that points along `angle`. @param {CanvasRenderingContext2D} context */
function head(context, x, y, angle, size) {
  context.save();
  context.translate(x, y);
  context.rotate(angle);
  context.beginPath();
  context.moveTo(size, 0);
  context.lineTo(-size * 0.55, size * 0.8);
  context.lineTo(-size * 0.55, -size * 0.8);
  context.closePath();
  context.fill();
  context.restore();
}

/** From one place to another along the x axis, with a head. @param {CanvasRenderingContext2D} context */
function straight(context, from, to, y, width) {
  const way = Math.sign(to - from);
  const size = Math.min(width * 1.7, Math.abs(to - from));
  context.lineWidth = width;
  context.lineCap = "butt";
  context.beginPath();
  context.moveTo(from, y);
  context.lineTo(to - way * size * 0.8, y);
  context.stroke();
  head(context, to - way * size, y, way > 0 ? 0 : Math.PI, size);
}

/**
 * The action as an arrow along the x axis from (x, y), and beneath it the last advice: what the policy did, and does now.
 * @param {CanvasRenderingContext2D} context
 * @param {{x: number, y: number, full: number, gap: number, width: number}} place `full`: length of an action of 1;
 *     `gap`: where the arrow begins, beside x
 * @param {number} value @param {import("./scenes.js").Advice|null} advice
 */
export function drawStraight(context, place, value, advice) {
  const { x, y, full, gap, width } = place;
  const at = (action) => x + (action < 0 ? -gap : gap) + action * full;
  if (Math.abs(value) > 0.004) {
    context.strokeStyle = context.fillStyle = tone(value);
    straight(context, x + Math.sign(value) * gap, at(value), y, width);
  }
  if (!advice) return;
  const lane = y - width * 2.2;
  const way = advice.h;
  context.globalAlpha = advice.strength;
  context.strokeStyle = context.fillStyle = colours.ink;
  if (Math.abs(at(advice.after) - at(advice.before)) > 3) straight(context, at(advice.before), at(advice.after), lane, width * 0.5);
  context.fillRect(at(advice.before) - 1, lane - width * 0.7, 2, width * 1.4);
  font(context, Math.max(12, width * 1.3), "600");
  context.textBaseline = "bottom";
  context.textAlign = way < 0 ? "right" : "left";
  label(context, advice, at(advice.before), lane - width);
  context.globalAlpha = 1;
}

/** What the policy did before the advice, and does now; readable on whatever is drawn beneath. */
function label(context, { before, after }, x, y) {
  const text = `${fixed(before, 2)} → ${fixed(after, 2)}`;
  context.lineJoin = "round";
  context.lineWidth = 4;
  context.strokeStyle = colours.sky;
  context.strokeText(text, x, y);
  context.fillText(text, x, y);
}

/** Half of the circle's part that an action of 1 covers. */
const SWEEP = (2 * Math.PI) / 3;

/** From one angle to another around a centre, with a head. @param {CanvasRenderingContext2D} context */
function curved(context, place, from, to, width) {
  const { x, y, radius } = place;
  const way = Math.sign(to - from);
  const size = Math.min(width * 1.7, Math.abs(to - from) * radius);
  const neck = to - (way * size) / radius;
  context.lineWidth = width;
  context.lineCap = "butt";
  context.beginPath();
  context.arc(x, y, radius, from, neck, way < 0);
  context.stroke();
  head(context, x + radius * Math.cos(neck), y + radius * Math.sin(neck), neck + (way * Math.PI) / 2, size);
}

/**
 * The action as an arrow around a pivot; a positive one turns counter-clockwise. Outside it, the last advice.
 * @param {CanvasRenderingContext2D} context @param {{x: number, y: number, radius: number, width: number}} place
 * @param {number} value @param {import("./scenes.js").Advice|null} advice
 */
export function drawCurved(context, place, value, advice) {
  const top = -Math.PI / 2;
  const at = (action) => top - action * SWEEP;
  context.lineCap = "round";
  context.lineWidth = place.width;
  context.strokeStyle = colours.faint;
  context.beginPath();
  context.arc(place.x, place.y, place.radius, at(1), at(-1));
  context.stroke();
  context.fillStyle = colours.muted;
  context.fillRect(place.x - 1, place.y - place.radius - place.width * 0.5, 2, place.width);
  if (Math.abs(value) > 0.004) {
    context.strokeStyle = context.fillStyle = tone(value);
    curved(context, place, top, at(value), place.width);
  }
  if (!advice) return;
  const outer = { ...place, radius: place.radius + place.width * 1.6 };
  context.globalAlpha = advice.strength;
  context.strokeStyle = context.fillStyle = colours.ink;
  if (Math.abs(advice.after - advice.before) > 0.01) curved(context, outer, at(advice.before), at(advice.after), place.width * 0.45);
  const middle = at((advice.before + advice.after) / 2);
  const away = outer.radius + 14;
  font(context, Math.max(12, Math.min(16, place.width)), "600");
  context.textBaseline = "middle";
  const side = Math.cos(middle);
  context.textAlign = side < -0.2 ? "right" : side > 0.2 ? "left" : "center";
  label(context, advice, place.x + away * side, place.y + (away + 4) * Math.sin(middle));
  context.globalAlpha = 1;
}
