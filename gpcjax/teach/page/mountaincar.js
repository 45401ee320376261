// The mountain car: place and speed, in a valley whose height is that of gymnasium.

import { drawStraight } from "./arrows.js";
import { colours, font } from "./canvas.js";
import { rangeOf } from "./format.js";

const GOAL = 0.45;
const heightAt = (x) => 0.45 * Math.sin(3 * x) + 0.55;

/** @param {any} task @returns {import("./scenes.js").Scene["draw"]} */
export function mountaincar(task) {
  const [low, high] = rangeOf(task.observations[0]) ?? [-1.2, 0.6];
  return (context, width, height, { obs, action, advice, small }) => {
    const scale = Math.min(width / (high - low), (height * 0.68) / 1.15);
    const left = (width - (high - low) * scale) / 2;
    const px = (x) => left + (x - low) * scale;
    const py = (x) => height * 0.9 - heightAt(x) * scale;

    hill(context, width, height, { low, high, px, py });
    flag(context, px(GOAL), py(GOAL), scale, small);

    const slope = Math.atan(0.45 * 3 * Math.cos(3 * obs[0]));
    const long = 0.17 * scale;
    const wheel = long * 0.17;
    context.save();
    context.translate(px(obs[0]), py(obs[0]));
    context.rotate(-slope);
    context.fillStyle = colours.body;
    context.beginPath();
    context.roundRect(-long / 2, -wheel * 3.1, long, wheel * 2, wheel * 0.6);
    context.roundRect(-long * 0.28, -wheel * 4.9, long * 0.5, wheel * 2.4, wheel * 0.8);
    context.fill();
    context.fillStyle = colours.ink;
    for (const side of [-0.28, 0.28]) {
      context.beginPath();
      context.arc(side * long, -wheel, wheel, 0, 2 * Math.PI);
      context.fill();
    }
    const place = { x: 0, y: -wheel * 2.1, full: 0.32 * scale, gap: long / 2 + 5, width: Math.max(6, long * 0.16) };
    drawStraight(context, place, action[0] ?? 0, advice);
    context.restore();
  };
}

/** The ground, as wide as the scene. @param {CanvasRenderingContext2D} context */
function hill(context, width, height, { low, high, px, py }) {
  const pieces = 90;
  context.beginPath();
  context.moveTo(px(low), height);
  for (let piece = 0; piece <= pieces; piece++) {
    const x = low + ((high - low) * piece) / pieces;
    context.lineTo(px(x), py(x));
  }
  context.lineTo(px(high), height);
  context.closePath();
  context.fillStyle = colours.faint;
  context.fill();
  context.beginPath();
  for (let piece = 0; piece <= pieces; piece++) {
    const x = low + ((high - low) * piece) / pieces;
    context.lineTo(px(x), py(x));
  }
  context.lineWidth = 2.5;
  context.strokeStyle = colours.muted;
  context.stroke();
}

/** The goal. @param {CanvasRenderingContext2D} context */
function flag(context, x, y, scale, small) {
  const high = 0.24 * scale;
  context.strokeStyle = colours.ink;
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(x, y);
  context.lineTo(x, y - high);
  context.stroke();
  context.fillStyle = colours.more;
  context.beginPath();
  context.moveTo(x, y - high);
  context.lineTo(x - high * 0.55, y - high * 0.8);
  context.lineTo(x, y - high * 0.6);
  context.fill();
  if (small) return;
  font(context, 12);
  context.fillStyle = colours.muted;
  context.textAlign = "center";
  context.textBaseline = "bottom";
  context.fillText("goal", x, y - high - 5);
}
