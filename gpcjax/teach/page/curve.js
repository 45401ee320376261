// Return per episode, growing, with the lines of the oracle and of doing nothing.

import { Board, colours, font } from "./canvas.js";
import { byId, counted, short } from "./format.js";

export class Curve {
  /** @param {import("./canvas.js").Painter} painter @param {() => import("./history.js").History} history */
  constructor(painter, history) {
    this.canvas = byId("curve");
    this.history = history;
    this.board = new Board(this.canvas, () => painter.need("curve"));
    painter.add("curve", () => this.draw());
  }

  draw() {
    const context = this.board.begin();
    if (!context) return;
    const history = this.history();
    const { taught, runs, lines } = history;
    const { width, height } = this.board;
    const known = [...Object.values(lines).filter((each) => Number.isFinite(each))];
    const [low, high] = extent([taught, runs], known);
    const box = { left: 50, right: width - 10, top: 10, bottom: height - 22 };
    const last = Math.max(10, history.count);
    const x = (episode) => box.left + ((episode - 1) / (last - 1)) * (box.right - box.left);
    const y = (total) => box.bottom - ((total - low) / (high - low)) * (box.bottom - box.top);
    if (taught.length || runs.length || known.length) axes(context, box, { low, high, last, x, y });
    this.level(context, box, y, lines.idle, "doing nothing", "right");
    // The first episodes are at the left; later ones come near to this line at the right.
    this.level(context, box, y, lines.oracle, "oracle", history.count < last / 2 ? "right" : "left");
    drawTaught(context, taught, x, y);
    drawRuns(context, runs, x, y, box);
    if (!taught.length) {
      font(context, 12);
      context.fillStyle = colours.muted;
      context.textAlign = "center";
      context.textBaseline = "middle";
      if (!known.length) context.fillText("a point for each episode that ends", (box.left + box.right) / 2, (box.top + box.bottom) / 2);
    }
    this.describe(history);
  }

  /** A line across, with its name on it. @param {CanvasRenderingContext2D} context */
  level(context, box, y, value, name, side) {
    if (!Number.isFinite(value)) return;
    context.strokeStyle = colours.muted;
    context.lineWidth = 1.2;
    context.setLineDash([5, 4]);
    context.beginPath();
    context.moveTo(box.left, y(value));
    context.lineTo(box.right, y(value));
    context.stroke();
    context.setLineDash([]);
    font(context, 11.5, "500");
    // A curve that grows leaves room at its upper left and at its lower right.
    context.textAlign = side;
    const beneath = y(value) < box.top + 20;
    context.textBaseline = beneath ? "top" : "bottom";
    const at = y(value) + (beneath ? 3 : -3);
    const text = `${name} ${short(value)}`;
    context.lineWidth = 3;
    context.strokeStyle = colours.surface;
    context.strokeText(text, box[side] + (side === "left" ? 4 : 0), at);
    context.fillStyle = colours.muted;
    context.fillText(text, box[side] + (side === "left" ? 4 : 0), at);
  }

  describe(history) {
    const { taught, lines } = history;
    const newest = taught.at(-1);
    const best = taught.reduce((most, each) => Math.max(most, each.total), -Infinity);
    const parts = newest
      ? [`${counted(history.count, "episode")}, the last with ${short(newest.total)}, the best with ${short(best)}`]
      : ["none yet"];
    if (Number.isFinite(lines.oracle)) parts.push(`oracle ${short(lines.oracle)}`);
    if (Number.isFinite(lines.idle)) parts.push(`doing nothing ${short(lines.idle)}`);
    this.canvas.setAttribute("aria-label", `Return per episode: ${parts.join("; ")}`);
  }
}

/** Lowest and highest return, with some air. */
function extent(series, known) {
  let low = Infinity;
  let high = -Infinity;
  for (const points of series) {
    for (const { total } of points) {
      if (total < low) low = total;
      if (total > high) high = total;
    }
  }
  for (const value of known) {
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  if (low > high) return [0, 1];
  const air = (high - low || Math.abs(high) || 1) * 0.08;
  return [low - air, high + air];
}

/** Steps of 1, 2 or 5 times a power of ten. */
function ticks(low, high, most) {
  const rough = (high - low) / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= rough) ?? rough;
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high; value += step) found.push(value);
  return found;
}

function axes(context, box, { low, high, last, x, y }) {
  font(context, 11);
  context.lineWidth = 1;
  context.strokeStyle = colours.line;
  context.fillStyle = colours.muted;
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const value of ticks(low, high, 4)) {
    context.beginPath();
    context.moveTo(box.left, Math.round(y(value)) + 0.5);
    context.lineTo(box.right, Math.round(y(value)) + 0.5);
    context.stroke();
    context.fillText(short(Math.abs(value) < 1e-9 ? 0 : value), box.left - 6, y(value));
  }
  context.textBaseline = "top";
  context.textAlign = "center";
  for (const value of ticks(1, last, 5)) {
    if (Number.isInteger(value) && value >= 1) context.fillText(String(value), Math.min(x(value), box.right - 6), box.bottom + 6);
  }
}

function drawTaught(context, taught, x, y) {
  context.strokeStyle = context.fillStyle = colours.body;
  context.lineWidth = 2;
  context.lineJoin = "round";
  context.beginPath();
  for (const each of taught) context.lineTo(x(each.x), y(each.total));
  context.stroke();
  const dots = taught.length <= 60 ? taught : taught.slice(-1);
  for (const each of dots) {
    context.beginPath();
    context.arc(x(each.x), y(each.total), each === taught.at(-1) ? 4 : 2.6, 0, 2 * Math.PI);
    context.fill();
  }
}

/** Evaluations, apart: hollow diamonds, the newest with its name. */
function drawRuns(context, runs, x, y, box) {
  context.strokeStyle = colours.run;
  context.fillStyle = colours.surface;
  context.lineWidth = 2;
  for (const each of runs) {
    const [at, high] = [x(Math.max(1, each.x)), y(each.total)];
    context.beginPath();
    context.moveTo(at, high - 5.5);
    context.lineTo(at + 5.5, high);
    context.lineTo(at, high + 5.5);
    context.lineTo(at - 5.5, high);
    context.closePath();
    context.fill();
    context.stroke();
  }
  const newest = runs.at(-1);
  if (!newest) return;
  font(context, 11.5, "500");
  const at = x(Math.max(1, newest.x));
  const right = at > (box.left + box.right) / 2;
  context.textAlign = right ? "right" : "left";
  context.textBaseline = "middle";
  context.fillStyle = colours.run;
  context.fillText(`run ${short(newest.total)}`, at + (right ? -10 : 10), y(newest.total));
}
