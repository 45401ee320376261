// Numbers: of the episode, of the learner, and what the policy sees.

import { byId, decimals, element, fixed, rangeOf, say, short } from "./format.js";

/** name, what it means. */
const NUMBERS = [
  ["episode", "Episode", "episodes that were taught, and this one"],
  ["step", "Step", "of this episode"],
  ["total", "Return", "of this episode so far"],
  ["corrections", "Corrections", "advices that were learned from"],
  ["rate", "Learning rate", "how far the last advice moved the policy"],
  ["points", "Points", "kept by the policy, and by the model of you"],
];

export class Panels {
  /** @param {import("./canvas.js").Painter} painter @param {import("./lesson.js").Lesson} lesson */
  constructor(painter, lesson) {
    this.lesson = lesson;
    /** @type {Record<string, HTMLElement>} */
    this.numbers = {};
    for (const [name, label, title] of NUMBERS) {
      this.numbers[name] = element("dd", {}, "–");
      byId("numbers").append(element("div", { title }, element("dt", {}, label), this.numbers[name]));
    }
    this.root = document.documentElement;
    /** @type {{node: Text, digits: number}[]} */
    this.seen = [];
    painter.add("step", () => this.drawStep());
    painter.add("learner", () => this.drawLearner());
  }

  /** @param {any} task */
  build(task) {
    const rows = task.observations.map((observation, k) => {
      const range = rangeOf(observation);
      const node = document.createTextNode("–");
      this.seen[k] = { node, digits: range ? decimals(range[1] - range[0]) : 4 };
      const cell = element("td", { "data-obs": String(k) });
      cell.append(element("span", {}, node));
      return element("tr", {}, element("th", { scope: "row" }, observation.name), cell);
    });
    this.seen.length = rows.length;
    byId("seen").replaceChildren(...rows);
    say(byId("unit"), task.unit ?? "");
    for (const node of Object.values(this.numbers)) say(node, "–");
    this.drawLearner();
  }

  drawStep() {
    const { frame, task, history, state } = this.lesson;
    if (!frame || !task) return;
    say(this.numbers.episode, state.mode === "run" ? "evaluation" : String(history.count + 1));
    say(this.numbers.step, `${frame.step}${task.max_steps ? ` / ${task.max_steps}` : ""}`);
    say(this.numbers.total, Math.abs(frame.total) < 1000 ? fixed(frame.total, Number.isInteger(frame.total) ? 0 : 1) : short(frame.total));
    this.root.dataset.episode = String(frame.episode);
    this.root.dataset.step = String(frame.step);
    for (const [k, { node, digits }] of this.seen.entries()) {
      // A plain hyphen for a minus: whoever copies or reads these gets numbers.
      const value = frame.obs[k];
      const text = Number.isFinite(value) ? value.toFixed(digits) : "–";
      if (node.data !== text) node.data = text;
    }
  }

  drawLearner() {
    const { corrections, rate, points } = this.lesson;
    say(this.numbers.corrections, corrections.toLocaleString("en"));
    say(this.numbers.rate, short(rate));
    say(this.numbers.points, points ? points.map((count) => (count ?? 0).toLocaleString("en")).join(" · ") : "–");
    this.root.dataset.corrections = String(corrections);
  }
}
