// What is read and answered: the first page, consent, the check, instructions, questions, the end.

import { byId, element } from "/page/format.js";
import { form } from "./questions.js";

/** Paragraphs of a text; nothing in it is ever parsed as HTML. @param {string} text */
const paragraphs = (text) => text.split(/\n\s*\n/).map((each) => element("p", {}, each.replace(/\s*\n\s*/g, " ").trim()));

/** @param {string} words @param {() => void} act @param {string} [kind] */
function button(words, act, kind = "") {
  const made = element("button", { type: "button", class: kind }, words);
  made.addEventListener("click", act);
  return made;
}

const actions = (...buttons) => element("p", { class: "actions" }, ...buttons);

/** Puts these nodes on the sheet, with the focus on it, so that a screen reader begins there. @param {...Node} nodes */
function put(...nodes) {
  byId("sheet").replaceChildren(...nodes);
  byId("reading").focus({ preventScroll: true });
  byId("reading").scrollTo(0, 0);
  scrollTo(0, 0);
}

/** Its buttons rest until the server has answered, or something was wrong. @param {boolean} on */
export function wait(on) {
  for (const each of byId("sheet").querySelectorAll("button")) each.disabled = on;
}

/** @param {string} title @param {string} text */
export const note = (title, text) => put(element("h2", {}, title), ...paragraphs(text));

/** @param {any} hello @param {string} wrong @param {(code: string) => void} join */
export function first(hello, wrong, join) {
  const title = element("h2", {}, hello.title);
  const trouble = wrong ? [element("p", { class: "bad", role: "alert" }, wrong)] : [];
  if (!hello.typed) {
    const text = "Please open this page by the link that you were given: it has your code.";
    return put(title, ...(wrong ? trouble : [element("p", {}, text)]));
  }
  const input = element("input", {
    class: "code-field", id: "code", maxlength: "64", autocomplete: "off", autocapitalize: "off", spellcheck: "false",
  });
  const made = element("form", {},
    element("p", {}, element("label", { for: "code" }, "Please type the code that you were given.")),
    input, ...trouble,
    element("p", { class: "actions" }, element("button", { class: "primary" }, "Begin, or go on")));
  made.addEventListener("submit", (event) => {
    event.preventDefault();
    if (input.value.trim()) join(input.value.trim());
  });
  put(title, made);
  input.focus();
}

/** @param {any} step @param {(on: boolean) => void} agree */
export function consent(step, agree) {
  put(element("h2", {}, "Before you begin"), ...paragraphs(step.text),
    actions(button("I agree and take part", () => agree(true), "primary"), button("I do not take part", () => agree(false))));
}

const NAMES = [["width", "Width of the window", "px"], ["height", "Height of the window", "px"],
  ["frame_rate", "Frames a second", ""], ["round_trip", "To the server and back", "ms"]];

/** @param {any} step @param {() => Promise<any>} measure @param {(measured: any) => void} send */
export function check(step, measure, send) {
  const title = element("h2", {}, "Your screen and connection");
  const begin = () => {
    put(title, element("p", {}, "Measuring. This takes a few seconds; please leave this page in front."),
      element("div", { class: "busy", "aria-hidden": "true" }, element("span")));
    measure().then((measured) => {
      const rows = NAMES.map(([name, words, unit]) => element("tr", {}, element("th", { scope: "row" }, words),
        element("td", {}, `${Math.round(measured[name])} ${unit}`)));
      put(title, element("table", { class: "measures" }, element("tbody", {}, ...rows)));
      send(measured);
    });
  };
  if (!step.again) {
    put(title, ...paragraphs("We look whether your screen and your connection are quick enough for the tasks. Please use a computer with a keyboard, or turn your phone to its side."),
      actions(button("Begin the check", begin, "primary")));
    return;
  }
  put(title, element("p", { class: "bad", role: "alert" }, "This is not enough yet:"),
    element("ul", {}, ...step.wrong.map((each) => element("li", {}, each))),
    actions(button("Check again", begin, "primary")));
}

/** @param {any} step @param {() => void} goOn */
export function instructions(step, goOn) {
  const next = step.trial ? "Go to a short trial" : "Go to the first run";
  put(element("h2", {}, "What you do"), ...paragraphs(step.text), actions(button(next, goOn, "primary")));
}

/** @param {any} step @param {(values: any) => void} send */
export function questions(step, send) {
  const { about } = step;
  const of = about ? `Learner ${about.letter}, ${about.task}` : "At the end";
  put(element("h2", {}, step.questions.length > 1 ? "Some questions" : "A question"),
    element("p", { class: "small" }, of), form(step.questions, send));
}

/** @param {any} ended */
export function end(ended) {
  const nodes = [element("h2", {}, ended.state === "complete" ? "Thank you" : "The end"), ...paragraphs(ended.text)];
  if (ended.code) nodes.push(element("p", {}, "Your code of completion:"), element("span", { class: "given-code" }, ended.code));
  // The link is the study's own, from its file.
  if (ended.link) nodes.push(element("p", {}, element("a", { class: "button", href: ended.link, rel: "noreferrer" }, "Return to the platform")));
  put(...nodes);
}

/** @param {() => void} take */
export function elsewhere(take) {
  put(element("h2", {}, "You take part in another window"),
    element("p", {}, "This study is open with your code in another window or on another device. If you go on here, the other one stops; nothing is lost."),
    actions(button("Go on here", take, "primary")));
}
