// The experimenter's page: who is where, what is wrong, and the few things that can be done about it.

import { Connection } from "/page/connection.js";
import { byId, counted, element, say, short } from "/page/format.js";

const connection = new Connection({ message, picture: () => {}, status }, "/experimenter/live");
let people = null;
/** What is done when the dialog is confirmed. @type {() => void} */
let confirmed = () => {};

/** @param {string} text */
function banner(text) {
  byId("banner").hidden = text === "";
  say(byId("banner"), text);
}

function status(to) {
  banner(to === "open" ? "" : "The connection is lost, trying again. The study goes on if its server does.");
}

/** @param {string} title @param {string} text @param {string} yes @param {() => void} act */
function ask(title, text, yes, act) {
  say(byId("sure-title"), title);
  say(byId("sure-text"), text);
  say(byId("sure-yes"), yes);
  confirmed = act;
  byId("sure-dialog").returnValue = "no";
  byId("sure-dialog").showModal();
}

/** "3 min ago" @param {string} time */
function ago(time) {
  const seconds = Math.max(0, (Date.now() - Date.parse(time)) / 1000);
  if (seconds < 90) return `${Math.round(seconds)} s ago`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min ago`;
  return seconds < 129600 ? `${Math.round(seconds / 3600)} h ago` : `${Math.round(seconds / 86400)} days ago`;
}

const WHY = {
  start: "has not begun", you: "pauses", connection: "connection lost", away: "page hidden", idle: "no key for long",
  experimenter: "paused by you", problem: "problem",
};

function where(row) {
  if (row.problem) return element("span", { class: "problem" }, row.problem);
  if (row.state !== "active") return element("span", { class: "faint" }, row.why);
  if (!row.lesson) return element("span", { class: row.here ? "" : "faint" }, row.here ? "reads or answers" : "not here");
  const { episode, step, total, corrections, why } = row.lesson;
  const doing = why ? (WHY[why] ?? why) : "teaches";
  const numbers = [episode !== null ? `episode ${episode + 1}` : "", step !== null ? `step ${step}` : "", total !== null ? `return ${short(total)}` : "",
    corrections !== null ? counted(corrections, "correction") : ""].filter(Boolean);
  return element("span", { class: "number" }, `${doing}: ${numbers.join(", ")}`);
}

function button(words, act, kind = "") {
  const made = element("button", { type: "button", class: kind }, words);
  made.addEventListener("click", act);
  return made;
}

function orders(row) {
  const { code } = row;
  const made = [];
  if (row.state === "active") {
    if (row.here || row.held) made.push(button(row.held ? "Let go on" : "Pause", () => connection.send("pause", { code, on: !row.held })));
    made.push(button("Stop", () => ask(`Stop ${code}?`, "The part of this participant ends here, and the slot is given to another. What was recorded stays.", "Stop", () => connection.send("stop", { code }))));
  }
  made.push(button("Delete", () => ask(`Delete ${code}?`, "Everything of this participant is removed from the study's folder, and what was made of the data of all. This cannot be undone.", "Delete", () => connection.send("delete", { code })), "danger"));
  return made.flatMap((each) => [each, " "]);
}

/** What a row's buttons depend on: they are made anew only where that has changed, so that a click meets what it was meant for. */
const key = (row) => [row.code, row.state, row.here, row.held].join(" ");

/** @type {Map<string, {key: string, node: HTMLElement, cells: HTMLElement[]}>} */
const rows = new Map();

function draw(row) {
  let kept = rows.get(row.code);
  if (!kept || kept.key !== key(row)) {
    const cells = Array.from({ length: 7 }, (_, k) => element("td", { class: k === 3 || k === 4 || k === 5 ? "wide" : "number" }));
    const node = element("tr", {}, ...cells, element("td", {}, ...orders(row)));
    kept = { key: key(row), node, cells };
    rows.set(row.code, kept);
  }
  const [code, state, runs, step, now, order, seen] = kept.cells;
  code.replaceChildren(element("span", { class: `dot${row.here ? " here" : ""}`, title: row.here ? "here" : "not here" }), row.code);
  say(state, row.held ? "paused" : row.state);
  say(runs, `${row.runs[0]} of ${row.runs[1]}`);
  say(step, row.step || "–");
  now.replaceChildren(where(row));
  say(order, `${row.arm === "all" ? "" : `${row.arm}: `}${row.order}; ${row.tasks.join(", ")}`);
  say(seen, ago(row.seen));
  return kept.node;
}

function show() {
  const { title, held, free, slots, seats, places } = people;
  document.title = `Experimenter: ${title}`;
  say(byId("title"), title);
  const states = people.rows.map((row) => row.state);
  const count = (state) => states.filter((each) => each === state).length;
  const fact = (value, words) => element("span", {}, element("b", {}, String(value)), ` ${words}`);
  byId("facts").replaceChildren(fact(people.rows.filter((row) => row.here).length, "here"), fact(`${seats} of ${places}`, "places in use"),
    fact(count("complete"), "complete"), fact(states.length - count("complete") - count("active"), "ended before"), fact(`${free} of ${slots}`, "slots free"));
  say(byId("pause-all"), held ? "Let all go on" : "Pause all");
  byId("pause-all").setAttribute("aria-pressed", String(held));
  const nodes = people.rows.map(draw);
  const old = [...byId("people").children];
  if (nodes.length !== old.length || nodes.some((node, k) => node !== old[k])) byId("people").replaceChildren(...nodes);
  byId("faults").replaceChildren(...people.faults.map((text) => element("li", {}, text)));
  byId("nobody").hidden = nodes.length > 0;
}

function message(content) {
  switch (content.type) {
    case "people":
      people = content;
      return show();
    case "deleted":
      return banner(`Removed: ${content.removed.join("; ")}`);
    case "problem":
      return banner(content.text);
  }
}

byId("pause-all").addEventListener("click", () => connection.send("pause", { code: "", on: !people?.held }));
byId("stop-all").addEventListener("click", () => ask("Stop all?", "The part of every participant who has not finished ends here. What was recorded stays.", "Stop all", () => connection.send("stop", { code: "" })));
byId("sure-dialog").addEventListener("close", () => byId("sure-dialog").returnValue === "yes" && confirmed());
connection.open();
