// What is said: the card and the ribbon of a phase, the line under the scene, and the polite voice for screen readers.

import { GLYPHS, LETTERS, arrows, hintOf, words } from "./controls.js";
import { byId, capital, element, fixed, say } from "./format.js";

const PHASES = {
  connecting: "Connecting", preparing: "Preparing", waiting: "Ready", teaching: "You teach", paused: "Paused",
  run: "Evaluation", taken: "Taught elsewhere", lost: "Connection lost", problem: "Stopped",
};
const VOICE_EVERY = 1500;
const HAPPENED = 6000;

export class Notices {
  /** @param {import("./lesson.js").Lesson} lesson */
  constructor(lesson) {
    this.lesson = lesson;
    this.nodes = Object.fromEntries(
      ["card", "card-title", "card-keys", "card-text", "card-busy", "card-button", "ribbon", "said", "phase-word", "live"]
        .map((id) => [id, byId(id)]),
    );
    /** @type {string[]} */
    this.toVoice = [];
    this.voicing = false;
    this.happenedAt = -Infinity;
    this.shown = "";
  }

  /** The keys of the first pair of dimensions and what they do. @param {any} task */
  build(task) {
    const lines = [...arrows(task, 0)].map(([arrow, { dim, h }]) =>
      element("p", {}, element("kbd", {}, GLYPHS[arrow]), element("kbd", {}, LETTERS[arrow]), ` ${words(task, dim, h)}`));
    this.nodes["card-keys"].replaceChildren(...lines);
  }

  /** @param {import("./lesson.js").Phase} phase */
  show(phase) {
    const { lesson } = this;
    document.documentElement.dataset.phase = phase;
    say(this.nodes["phase-word"], PHASES[phase]);
    const card = this.card(phase);
    this.nodes.card.hidden = card === null;
    if (card) {
      say(this.nodes["card-title"], card.title);
      say(this.nodes["card-text"], card.text);
      say(this.nodes["card-button"], card.button ?? "");
      this.nodes["card-button"].hidden = !card.button;
      this.nodes["card-busy"].hidden = !card.busy;
      this.nodes["card-keys"].hidden = !card.keys;
    }
    const ribbon = this.ribbon(phase);
    this.nodes.ribbon.hidden = ribbon === "";
    say(this.nodes.ribbon, ribbon);
    const told = card ? `${card.title.replace(/[.]$/, "")}. ${card.text}` : ribbon || PHASES[phase];
    if (told !== this.shown) this.voice(told);
    this.shown = told;
    document.title = `${PHASES[phase]} · ${lesson.task?.label ?? "gpcjax"}`;
  }

  /** @returns {{title: string, text: string, button?: string, busy?: boolean, keys?: boolean}|null} */
  card(phase) {
    const { task, preparing, trouble, reason, state } = this.lesson;
    switch (phase) {
      case "connecting":
        return { title: "Connecting", text: "Looking for the lesson.", busy: true };
      case "preparing":
        return { title: hintOf(task), keys: true, text: `Preparing${preparing ? `: ${preparing}` : ""}. A moment.`, busy: true };
      case "waiting":
        return {
          title: hintOf(task), keys: true, button: "Start",
          text: "Press when you would do it differently. Each press teaches at once; hold to say it again and again.",
        };
      case "taken":
        return {
          title: "Another page is teaching", button: "Teach here instead",
          text: "One page teaches at a time. If you take over, the other one stops; nothing that was taught is lost.",
        };
      case "lost":
        return {
          title: "Connection lost", busy: true,
          text: `${reason ? `${capital(reason)}. ` : ""}The task is paused and nothing is lost. Trying again.`,
        };
      case "problem":
        return { title: "Stopped: there is a problem", text: trouble || "The server could not go on.", button: "Go on" };
      case "paused":
        if (state.why !== "connection") return null;
        return { title: "Connected again", text: "The task waited for you, and nothing is lost.", button: "Go on" };
    }
    return null;
  }

  ribbon(phase) {
    if (phase === "run") return "Evaluation: nothing is learned. L to teach again.";
    if (phase !== "paused" || this.lesson.state.why === "connection") return "";
    return `${this.lesson.state.mode === "run" ? "Evaluation paused" : "Paused"}: Space goes on, “.” is one step`;
  }

  /** Confirms an advice by what it changed. @param {any} advised @param {any} task */
  advised(advised, task) {
    // What happened just before is not overwritten by a held key at once.
    if (performance.now() - this.happenedAt < 1200) return;
    const { dim, h, before, after, status } = advised;
    const asked = capital(words(task, dim, h));
    const same = Math.abs(after - before) < 0.0005;
    let text = `${asked} here: ${fixed(before, 2)} → ${fixed(after, 2)}`;
    if (same && Math.abs(after) > 0.999) text = `${asked} here: ${fixed(after, 2)}, as far as it goes`;
    if (status === "full") text += " (the dictionary is full)";
    else if (status && status !== "ok") text += ` (${status})`;
    this.line(text, h < 0 ? "less" : "more");
  }

  /** Something that happened: seen under the scene, and heard. @param {string} text @param {string} [kind] */
  happened(text, kind = "note") {
    this.happenedAt = performance.now();
    this.line(text, kind);
    this.voice(text);
  }

  line(text, kind) {
    say(this.nodes.said, text);
    this.nodes.said.dataset.kind = kind;
    clearTimeout(this.clearing);
    this.clearing = setTimeout(() => {
      this.nodes.said.textContent = "\u00a0";
    }, HAPPENED);
  }

  /** Says it to a screen reader, not faster than it can be heard. @param {string} text */
  voice(text) {
    this.toVoice.push(text);
    if (this.toVoice.length > 3) this.toVoice.shift();
    if (!this.voicing) this.nextVoice();
  }

  nextVoice() {
    const text = this.toVoice.shift();
    this.voicing = text !== undefined;
    if (text === undefined) return;
    this.nodes.live.textContent = text;
    setTimeout(() => this.nextVoice(), VOICE_EVERY);
  }
}
