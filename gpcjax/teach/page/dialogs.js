// Help, begin anew, save and open. A <dialog> keeps the focus inside, closes with Escape, and gives the focus back.

import { GLYPHS, LETTERS, arrows, words } from "./controls.js";
import { byId, capital, element, say } from "./format.js";
import { KEYS } from "./keys.js";

export class Dialogs {
  /**
   * @param {object} to
   * @param {(name: string, settings: Record<string, number>) => void} to.begin
   * @param {(name: string) => void} to.save
   * @param {(name: string) => void} to.open
   * @param {() => void} to.opened the task must not go on unseen, nor keys be held
   */
  constructor(to) {
    this.to = to;
    /** @type {any} */
    this.task = null;
    this.pair = 0;
    for (const name of ["help", "anew", "files"]) {
      byId(`open-${name}`).addEventListener("click", () => this.open(name));
      // A click on what is behind a dialog closes it.
      byId(name).addEventListener("click", (event) => event.target === byId(name) && byId(name).close());
    }
    byId("anew-learner").addEventListener("change", () => this.showSettings());
    byId("anew-cancel").addEventListener("click", () => byId("anew").close());
    byId("anew-form").addEventListener("submit", () => this.begin());
    byId("save").addEventListener("click", () => this.save());
    byId("save-name").addEventListener("keydown", (event) => {
      if (event.key !== "Enter") return;
      event.preventDefault();
      this.save();
    });
  }

  get isOpen() {
    return document.querySelector("dialog[open]") !== null;
  }

  /** @param {string} name */
  open(name) {
    if (this.isOpen || (!this.task && name !== "help")) return;
    this.to.opened();
    if (name === "help") this.showKeys();
    if (name === "anew") this.showLearners();
    if (name === "files") this.showSaves();
    byId(name).showModal();
    if (name === "files") byId("save-name").select();
  }

  /** @param {any} task */
  build(task) {
    this.task = task;
    this.saves = task.saves ?? [];
  }

  showKeys() {
    const rows = [];
    if (this.task) {
      for (const [arrow, { dim, h }] of arrows(this.task, this.pair)) {
        rows.push([[GLYPHS[arrow], LETTERS[arrow]], `${words(this.task, dim, h)}; hold to repeat`]);
      }
      if (this.task.actions.length > 2) rows.push([["1", "…", "9"], "what the arrows act on"]);
    }
    byId("help-keys").replaceChildren(...[...rows, ...KEYS].map(([keys, text]) =>
      element("tr", {}, element("th", { scope: "row" }, ...keys.map((key) => element("kbd", {}, key))), element("td", {}, text))));
  }

  showLearners() {
    const { learners, learner } = this.task;
    byId("anew-learner").replaceChildren(...learners.map(({ name, label }) => element("option", { value: name }, label || name)));
    byId("anew-learner").value = learner.name;
    this.showSettings();
  }

  showSettings() {
    const name = byId("anew-learner").value;
    const { learner, learners } = this.task;
    const chosen = name === learner.name ? learner : learners.find((each) => each.name === name);
    byId("anew-settings").replaceChildren(...(chosen?.settings ?? []).map(field));
  }

  begin() {
    const settings = {};
    for (const input of byId("anew-settings").querySelectorAll("input")) {
      if (input.value !== "" && Number.isFinite(input.valueAsNumber)) settings[input.name] = input.valueAsNumber;
    }
    this.to.begin(byId("anew-learner").value, settings);
  }

  showSaves() {
    say(byId("folder"), this.task.folder ? `Kept in ${this.task.folder}` : "");
    const rows = this.saves.map((name) => {
      const button = element("button", { type: "button", "aria-label": `Open ${name}` }, "Open");
      button.addEventListener("click", () => {
        byId("files").close();
        this.to.open(name);
      });
      return element("li", {}, element("span", {}, name), button);
    });
    byId("saves").replaceChildren(...(rows.length ? rows : [element("li", { class: "none" }, "Nothing was saved yet.")]));
  }

  save() {
    const name = byId("save-name").value.trim();
    if (!name) {
      byId("save-name").focus();
      return;
    }
    this.to.save(name);
    byId("files").close();
  }

  /** @param {string[]} saves */
  saved(saves) {
    this.saves = saves;
    if (byId("files").open) this.showSaves();
  }
}

/** An input for a setting. @param {any} setting */
function field({ name, label, symbol, value, low, high, text }) {
  const id = `setting-${name}`;
  const input = element("input", { id, name, type: "number", step: "any", inputmode: "decimal" });
  if (Number.isFinite(low)) input.setAttribute("min", String(low));
  if (Number.isFinite(high)) input.setAttribute("max", String(high));
  if (value !== null && value !== undefined) input.setAttribute("value", String(value));
  const parts = [element("span", { class: "setting-name" }, capital(label || name.replaceAll("_", " ")))];
  if (symbol && symbol !== name) parts.push(element("span", { class: "symbol" }, symbol));
  const wrapped = element("div", { class: "setting" }, element("label", { for: id }, ...parts), input);
  if (text) {
    input.setAttribute("aria-describedby", `${id}-text`);
    wrapped.append(element("p", { class: "small", id: `${id}-text` }, text));
  }
  return wrapped;
}
