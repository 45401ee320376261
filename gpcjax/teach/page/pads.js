// The buttons of advice, less and more, and between them a bar of the action.

import { GLYPHS, LABELS, LETTERS, buttons, dimensions, pairs } from "./controls.js";
import { byId, capital, element, fixed, say } from "./format.js";

export class Pads {
  /**
   * @param {object} to
   * @param {(source: string, dim: number, h: number, at: number) => void} to.hold
   * @param {(source: string) => void} to.release
   * @param {(pair: number) => void} to.choose another pair of dimensions
   */
  constructor(to) {
    this.to = to;
    this.root = byId("pads");
    /** @type {Map<number, any>} */
    this.rows = new Map();
    this.root.addEventListener("contextmenu", (event) => event.preventDefault());
    this.root.addEventListener("pointerdown", (event) => this.down(event));
    for (const type of ["pointerup", "pointercancel", "lostpointercapture"]) {
      this.root.addEventListener(type, (event) => to.release(`pointer${event.pointerId}`));
    }
  }

  /** @param {PointerEvent} event */
  down(event) {
    const button = /** @type {HTMLElement} */ (event.target).closest(".pad");
    if (!(button instanceof HTMLElement) || event.button !== 0) return;
    event.preventDefault();
    button.setPointerCapture(event.pointerId);
    this.press(button, `pointer${event.pointerId}`, event.timeStamp);
  }

  /** @param {HTMLElement} button @param {string} source @param {number} at */
  press(button, source, at) {
    this.to.hold(source, Number(button.dataset.dim), Number(button.dataset.h), at);
  }

  /** @param {any} task @param {number} pair */
  build(task, pair) {
    this.rows.clear();
    const rows = dimensions(task, pair).map((dim) => this.row(task, pair, dim));
    this.root.replaceChildren(...(pairs(task) > 1 ? [this.chooser(task, pair)] : []), ...rows);
  }

  chooser(task, pair) {
    const group = element("div", { class: "pairs", role: "group", "aria-label": "What the arrows act on" });
    for (let each = 0; each < pairs(task); each++) {
      const names = dimensions(task, each).map((dim) => task.actions[dim].name).join(", ");
      const number = element("kbd", {}, String(each + 1));
      const button = element("button", { type: "button", "aria-pressed": String(each === pair) }, number, ` ${names}`);
      button.addEventListener("click", () => this.to.choose(each));
      group.append(button);
    }
    return group;
  }

  row(task, pair, dim) {
    const action = task.actions[dim];
    const [first, last] = buttons(task, pair, dim);
    const made = [first, last].map(({ h, key, words }) => {
      const button = element(
        "button",
        {
          type: "button", class: `pad ${h < 0 ? "pad-less" : "pad-more"}`, "data-dim": String(dim), "data-h": String(h),
          "aria-label": `${words} (${LABELS[key]})`, "aria-keyshortcuts": `Arrow${capital(key)} ${LETTERS[key]}`,
        },
        element("span", { class: "pad-key", "aria-hidden": "true" }, GLYPHS[key]),
        element("span", { class: "pad-words" }, words),
      );
      return button;
    });
    const fill = element("span", { class: "bar-fill" });
    const before = element("span", { class: "bar-before" });
    const value = element("span", { class: "bar-value" }, "0.00");
    const track = element("span", { class: "bar-track" }, fill, before, element("span", { class: "bar-zero" }));
    const name = task.actions.length > 1 ? action.name : "action";
    const bar = element("div", { class: "bar", role: "img", "aria-label": `${name}: how it acts now` },
      element("span", { class: "bar-name" }, name), track, value);
    // The bar's left end is what the button on the left asks for.
    const turned = first.h > 0 ? -1 : 1;
    this.rows.set(dim, { fill, before, value, turned, by: { [first.h]: made[0], [last.h]: made[1] } });
    return element("div", { class: "pad-row" }, made[0], bar, made[1]);
  }

  /** @param {number} dim @param {number} h @param {boolean} on */
  light(dim, h, on) {
    this.rows.get(dim)?.by[h].classList.toggle("lit", on);
  }

  /** @param {number[]} action @param {import("./scenes.js").Advice|null} advice */
  draw(action, advice) {
    for (const [dim, row] of this.rows) {
      const value = action[dim] ?? 0;
      row.fill.style.transform = `scaleX(${((value * row.turned) / 2).toFixed(4)})`;
      row.fill.classList.toggle("negative", value < 0);
      say(row.value, fixed(value, 2));
      const told = advice?.dim === dim ? advice : null;
      row.before.style.opacity = told ? told.strength.toFixed(2) : "0";
      if (told) row.before.style.transform = `translateX(${(told.before * row.turned * 50).toFixed(2)}%)`;
    }
  }
}
