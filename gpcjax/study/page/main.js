// A participant's page: what the server says comes next is shown, what the person does goes to the server.

import { Connection } from "/page/connection.js";
import { byId, say } from "/page/format.js";
import { Measuring } from "./measuring.js";
import * as sheets from "./sheets.js";
import { Teaching } from "./teaching.js";

const KEPT = "gpcjax-study-code";

/** What the server said when this page came. @type {any} */
let hello = null;
/** The code that takes part here. */
let code = "";
/** @type {any} */
let step = null;
let over = false;
/** The next connection takes the place of another page. */
let taking = false;

const connection = new Connection({ message, picture: (_, image) => teaching.stage.scene?.picture?.(image), status }, "/part");
const send = (type, content) => connection.send(type, content);
/** What leads to another step: its buttons are asked once. */
const move = (type, content) => send(type, content) && sheets.wait(true);
const measuring = new Measuring(connection);
const teaching = new Teaching(send);

/** The code that a platform has put in the address, or that was typed in this tab before. */
function known() {
  const given = new URLSearchParams(location.search);
  const name = hello.parameters.find((each) => given.get(each));
  return name ? given.get(name) : sessionStorage.getItem(KEPT);
}

/** @param {string} wanted @param {boolean} [take] */
function join(wanted, take = false) {
  code = wanted;
  send("join", { code, take });
}

/** @param {string} text what is the matter; empty where nothing is */
function banner(text) {
  byId("banner").hidden = text === "";
  say(byId("banner"), text);
}

/** @param {boolean} working a run is shown, no sheet */
function layout(working) {
  byId("work").hidden = !working;
  byId("reading").hidden = working;
  document.body.classList.toggle("working", working);
  if (!working) teaching.hide();
}

/** @param {any} now */
function show(now) {
  const passed = step?.kind === "trial" && now.kind !== "trial";
  step = now;
  document.documentElement.dataset.step = now.kind;
  byId("leave").hidden = now.kind === "consent";
  byId("progress").hidden = false;
  say(byId("progress-word"), `Step ${now.index + 1} of ${now.count}`);
  byId("progress-fill").style.transform = `scaleX(${((now.index + 1) / now.count).toFixed(3)})`;
  byId("progress-bar").setAttribute("aria-valuenow", String(now.index + 1));
  byId("progress-bar").setAttribute("aria-valuemax", String(now.count));
  banner("");
  layout(now.kind === "run" || now.kind === "trial");
  switch (now.kind) {
    case "consent":
      return sheets.consent(now, (on) => move("agree", { on }));
    case "check":
      return sheets.check(now, () => measuring.all(), (measured) => send("measured", measured));
    case "instructions":
      return sheets.instructions(now, () => move("go_on"));
    case "questions":
      return sheets.questions(now, (values) => move("answers", { values }));
    case "run":
    case "trial":
      return teaching.show(now, passed);
  }
}

/** @param {any} ended */
function end(ended) {
  over = true;
  step = null;
  document.documentElement.dataset.step = "ended";
  byId("leave").hidden = byId("progress").hidden = true;
  sessionStorage.removeItem(KEPT);
  layout(false);
  sheets.end(ended);
}

/** @param {"open"|"lost"} to */
function status(to) {
  if (over) return;
  teaching.lesson.connected = to === "open";
  banner(to === "open" ? "" : "The connection is lost. Nothing that you did is lost; trying again.");
}

/** @param {any} content */
function message(content) {
  switch (content.type) {
    case "hello":
      hello = content;
      document.title = content.title;
      say(byId("title"), content.title);
      if (over) return;
      if (code || known()) {
        const take = taking;
        taking = false;
        return join(code || known(), take);
      }
      return sheets.first(hello, "", join);
    case "refused":
      code = "";
      sessionStorage.removeItem(KEPT);
      layout(false);
      return sheets.first(hello, content.text, join);
    case "elsewhere":
      layout(false);
      return sheets.elsewhere(() => join(code, true));
    case "gone":
      if (!connection.stays) return;
      layout(false);
      step = null;
      byId("leave").hidden = byId("progress").hidden = true;
      return sheets.elsewhere(() => {
        code ||= known() ?? "";
        taking = true;
        connection.open();
      });
    case "step":
      sessionStorage.setItem(KEPT, code);
      return show(content);
    case "ended":
      return end(content);
    case "problem":
      sheets.wait(false);
      return banner(content.text);
    case "pong":
      return measuring.pong(content.at);
    default:
      if (step) teaching.message(content);
  }
}

byId("leave").addEventListener("click", () => {
  if (teaching.running) send("pause", { on: true });
  byId("leaving").showModal();
});
byId("leaving").addEventListener("close", () => byId("leaving").returnValue === "leave" && send("leave"));
document.addEventListener("visibilitychange", () => step && send("hidden", { on: document.hidden }));
sheets.note("Connecting", "A moment.");
connection.open();
