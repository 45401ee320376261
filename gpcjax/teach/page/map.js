// The policy over two numbers of the observation, with the places of advice and where the task is now.

import { Board, colours, diverging, font } from "./canvas.js";
import { byId, element, rangeOf, say, short } from "./format.js";

export class PolicyMap {
  /**
   * @param {import("./canvas.js").Painter} painter @param {import("./lesson.js").Lesson} lesson
   * @param {(axes: {x: number, y: number, dim: number}) => void} ask
   */
  constructor(painter, lesson, ask) {
    this.lesson = lesson;
    this.ask = ask;
    this.painter = painter;
    this.canvas = byId("map");
    this.board = new Board(this.canvas, () => painter.need("map"));
    this.nowBoard = new Board(byId("map-now"), () => painter.need("map now"));
    this.selects = { x: byId("map-x"), y: byId("map-y"), dim: byId("map-dim") };
    this.axes = { x: 0, y: 1, dim: 0 };
    this.image = document.createElement("canvas");
    for (const name of ["x", "y", "dim"]) {
      this.selects[name].addEventListener("change", () => this.choose(name, Number(this.selects[name].value)));
    }
    painter.add("map", () => this.draw());
    painter.add("map now", () => this.drawNow());
  }

  /** @param {any} task @param {{x: number, y: number, dim: number}|null} before axes that were chosen for this task */
  build(task, before) {
    const names = task.observations.map((seen) => seen.name);
    const many = names.length > 1;
    for (const name of ["x", "y"]) this.selects[name].replaceChildren(...options(names));
    this.selects.dim.replaceChildren(...options(task.actions.map((action) => action.name)));
    byId("map-dim-label").hidden = task.actions.length < 2;
    const inside = (axis, other) => (axis < names.length ? axis : other);
    const [x, y] = task.axes ?? [0, 1];
    this.axes = before ?? { x: inside(x, 0), y: inside(y, many ? 1 : 0), dim: 0 };
    this.show();
    this.ask(this.axes);
  }

  /** @param {string} name @param {number} value */
  choose(name, value) {
    const before = { ...this.axes };
    this.axes = { ...this.axes, [name]: value };
    // The same number on both axes would be a line: they change places.
    if (this.axes.x === this.axes.y && this.lesson.task.observations.length > 1) {
      this.axes[name === "x" ? "y" : "x"] = before[name];
    }
    this.show();
    this.ask(this.axes);
  }

  /** The next pair of axes, and after the last pair the next dimension of the action. */
  next() {
    const size = this.lesson.task?.observations.length ?? 0;
    if (size < 2) return;
    let { x, y, dim } = this.axes;
    [x, y] = x > y ? [y, x] : [x, y];
    if (++y >= size) y = ++x + 1;
    if (y >= size) [x, y, dim] = [0, 1, (dim + 1) % this.lesson.task.actions.length];
    this.axes = { x, y, dim };
    this.show();
    this.ask(this.axes);
  }

  show() {
    for (const name of ["x", "y", "dim"]) this.selects[name].value = String(this.axes[name]);
    const action = this.lesson.task.actions[this.axes.dim];
    say(byId("legend-low"), action.less.words || "less");
    say(byId("legend-high"), action.more.words || "more");
    this.legend();
    this.painter.need("map", "map now");
  }

  legend() {
    const context = byId("legend").getContext("2d");
    const image = context.createImageData(255, 1);
    new Uint32Array(image.data.buffer).set(diverging);
    context.putImageData(image, 0, 0);
  }

  /** Takes a new map: its pixels once, not at each drawing. @param {any} map */
  take(map) {
    const [wide, high] = map.size;
    const bytes = Uint8Array.from(atob(map.values), (letter) => letter.charCodeAt(0));
    const values = new Int8Array(bytes.buffer);
    if (values.length !== wide * high) return;
    this.lesson.map = { ...map, values };
    this.paint();
    this.painter.need("map", "map now");
  }

  /** The pixels of the map, in the colours of the theme. */
  paint() {
    const { map } = this.lesson;
    if (!map) return;
    const [wide, high] = map.size;
    if (this.image.width !== wide || this.image.height !== high) Object.assign(this.image, { width: wide, height: high });
    const context = this.image.getContext("2d");
    const image = context.createImageData(wide, high);
    const pixels = new Uint32Array(image.data.buffer);
    for (let row = 0; row < high; row++) {
      // The lowest row of the map is the last one of the picture.
      const to = (high - 1 - row) * wide;
      for (let column = 0; column < wide; column++) {
        pixels[to + column] = diverging[Math.max(-127, map.values[row * wide + column]) + 127];
      }
    }
    context.putImageData(image, 0, 0);
  }

  box(board) {
    return { left: 42, top: 6, wide: board.width - 50, high: board.height - 44 };
  }

  bounds() {
    const { map, task } = this.lesson;
    if (map && this.current(map)) return { low: map.low, high: map.high };
    const [x, y] = [this.axes.x, this.axes.y].map((k) => rangeOf(task.observations[k]) ?? [-1, 1]);
    return { low: [x[0], y[0]], high: [x[1], y[1]] };
  }

  current(map) {
    return map.x === this.axes.x && map.y === this.axes.y && map.dim === this.axes.dim;
  }

  draw() {
    const context = this.board.begin();
    if (!context || !this.lesson.task) return;
    const { map, task } = this.lesson;
    const box = this.box(this.board);
    const { low, high } = this.bounds();
    context.fillStyle = colours.faint;
    context.fillRect(box.left, box.top, box.wide, box.high);
    if (map && this.current(map)) {
      context.imageSmoothingEnabled = true;
      context.imageSmoothingQuality = "high";
      context.drawImage(this.image, box.left, box.top, box.wide, box.high);
      this.points(context, box, map);
    }
    context.strokeStyle = colours.line;
    context.lineWidth = 1;
    context.strokeRect(box.left + 0.5, box.top + 0.5, box.wide - 1, box.high - 1);
    this.name(context, box, low, high, task.observations);
    const [x, y] = [task.observations[this.axes.x].name, task.observations[this.axes.y].name];
    const count = map?.points.length ?? 0;
    const shown = `Map of the policy over ${x} and ${y}, with ${count} places of advice`;
    if (this.canvas.getAttribute("aria-label") !== shown) this.canvas.setAttribute("aria-label", shown);
  }

  points(context, box, map) {
    const [[left, bottom], [right, top]] = [map.low, map.high];
    context.fillStyle = colours.ink;
    context.strokeStyle = colours.surface;
    context.lineWidth = 1;
    context.beginPath();
    for (const [x, y] of map.points) {
      const px = box.left + ((x - left) / (right - left)) * box.wide;
      const py = box.top + (1 - (y - bottom) / (top - bottom)) * box.high;
      if (px < box.left || px > box.left + box.wide || py < box.top || py > box.top + box.high) continue;
      context.moveTo(px + 2, py);
      context.arc(px, py, 2, 0, 2 * Math.PI);
    }
    context.stroke();
    context.fill();
  }

  name(context, box, low, high, observations) {
    font(context, 11);
    context.fillStyle = colours.muted;
    const bottom = box.top + box.high;
    context.textBaseline = "top";
    context.textAlign = "left";
    context.fillText(end(low[0]), box.left, bottom + 5);
    context.textAlign = "right";
    context.fillText(end(high[0]), box.left + box.wide, bottom + 5);
    context.textBaseline = "middle";
    context.fillText(end(high[1]), box.left - 5, box.top + 7);
    context.fillText(end(low[1]), box.left - 5, bottom - 6);
    font(context, 12, "500");
    context.textAlign = "center";
    context.textBaseline = "top";
    context.fillStyle = colours.ink;
    context.fillText(observations[this.axes.x].name, box.left + box.wide / 2, bottom + 20, box.wide);
    context.save();
    context.translate(box.left - 26, box.top + box.high / 2);
    context.rotate(-Math.PI / 2);
    context.textBaseline = "middle";
    context.fillText(observations[this.axes.y].name, 0, 0, box.high - 40);
    context.restore();
  }

  /** Where the task is: on a canvas of its own, so that a step does not draw the map again. */
  drawNow() {
    const context = this.nowBoard.begin();
    const { frame, task } = this.lesson;
    if (!context || !frame || !task) return;
    const box = this.box(this.nowBoard);
    const { low, high } = this.bounds();
    const part = (k, axis) => Math.max(0, Math.min(1, (frame.obs[axis] - low[k]) / (high[k] - low[k])));
    const x = box.left + part(0, this.axes.x) * box.wide;
    const y = box.top + (1 - part(1, this.axes.y)) * box.high;
    context.beginPath();
    context.arc(x, y, 6.5, 0, 2 * Math.PI);
    context.lineWidth = 5;
    context.strokeStyle = colours.surface;
    context.stroke();
    context.lineWidth = 2.5;
    context.strokeStyle = colours.ink;
    context.stroke();
  }
}

/** An end of an axis, without zeros that say nothing. @param {number} value */
const end = (value) => short(value).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");

/** @param {string[]} names */
const options = (names) => names.map((name, k) => element("option", { value: String(k) }, name));
