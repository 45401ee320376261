// A run, or the trial: the scene, the keys, and a card that says what is to be done. Drawn by the modules of a lesson's page.

import { followTheme, Painter } from "/page/canvas.js";
import { arrows, GLYPHS, hintOf, LETTERS, pairs, words } from "/page/controls.js";
import { byId, capital, counted, element, fixed, say, short } from "/page/format.js";
import { listenToGamepads } from "/page/gamepad.js";
import { keepFocusOnClick, listenToKeys } from "/page/keys.js";
import { Lesson } from "/page/lesson.js";
import { Pads } from "/page/pads.js";
import { Presses } from "/page/presses.js";
import { Stage } from "/page/stage.js";

/** Of tasks that paint pictures themselves, for which nobody has the time where many teach. */
const SCENES = { lunarlander: "lander" };

const PAUSED = {
  you: ["Paused", "Take your time. The task waits for you."],
  connection: ["Connected again", "The task waited for you, and nothing is lost."],
  away: ["Paused", "The page was hidden, so the task has waited for you."],
  idle: ["Are you still there?", "No key was pressed for a while, so the task has stopped. Go on when you are ready."],
  experimenter: ["You can go on", "The experimenter had paused the study."],
  problem: ["There is a technical problem", "The experimenter has been told. Please wait a moment, then try again."],
};

export class Teaching {
  /** @param {(type: string, content?: object) => boolean} send */
  constructor(send) {
    this.send = send;
    this.lesson = new Lesson();
    this.painter = new Painter();
    followTheme(() => this.painter.need("scene"));
    /** The step that is shown; null while another part of the page is. @type {any} */
    this.step = null;
    this.held = false;
    this.waiting = "";
    this.last = null;
    this.pair = 0;
    this.pressed = 0;
    this.restUntil = 0;
    this.pads = new Pads({
      hold: (source, dim, h, at) => this.presses.hold(source, dim, h, at),
      release: (source) => this.presses.release(source),
      choose: (pair) => this.choose(pair),
    });
    this.stage = new Stage(this.painter, this.lesson, (action, advice) => this.pads.draw(action, advice));
    this.presses = new Presses((...press) => this.press(...press), (dim, h, on) => this.pads.light(dim, h, on));
    this.painter.add("numbers", () => this.numbers());
    const keys = {
      arrow: (arrow, source, at) => this.arrow(arrow, source, at),
      release: (source) => this.presses.release(source),
      command: (name) => name === "go" && this.step && this.toggle(),
    };
    listenToKeys({ ...keys, digit: (index) => this.choose(index), pad: (button, source, at) => this.pads.press(button, source, at) });
    listenToGamepads(keys);
    keepFocusOnClick();
    byId("card-button").addEventListener("click", () => this.toggle());
    byId("rest").addEventListener("click", () => this.toggle());
  }

  /** @param {any} step @param {boolean} passed the trial was the step before */
  show(step, passed) {
    this.passed = passed;
    const same = this.step?.name === step.name && this.step?.attempt === step.attempt;
    this.step = step;
    if (!same) {
      this.lesson.forget();
      this.lesson.connected = true;
      this.last = null;
      byId("needed").hidden = true;
      byId("pads").replaceChildren();
      say(byId("said"), "\u00a0");
    }
    this.waiting = "";
    this.lesson.ready = false;
    this.restUntil = performance.now() + 1000 * (step.rest ?? 0);
    say(byId("work-title"), step.kind === "trial" ? `Trial: ${step.task}` : `Learner ${step.letter}: ${step.task}`);
    this.changed();
  }

  hide() {
    this.presses.releaseAll();
    this.step = null;
  }

  get running() {
    return this.step !== null && this.lesson.ready && !this.lesson.state.paused && !this.held;
  }

  toggle() {
    const { state, ready } = this.lesson;
    if (!ready || this.held || performance.now() < this.restUntil) return;
    this.send("pause", { on: !state.paused });
  }

  press(dim, h, held, at) {
    if (!this.running) return;
    this.send("press", { id: ++this.pressed, dim, h, n: this.lesson.frame?.n ?? 0, at, held });
  }

  arrow(arrow, source, at) {
    const advice = this.running ? arrows(this.lesson.task, this.pair).get(arrow) : undefined;
    if (advice) this.presses.hold(source, advice.dim, advice.h, at);
    return advice !== undefined;
  }

  choose(index) {
    const { task } = this.lesson;
    if (!this.step || !task || index >= pairs(task) || index === this.pair) return;
    this.presses.releaseAll();
    this.pair = index;
    this.pads.build(task, index);
    this.painter.need("scene");
  }

  /** What the server tells of a lesson. @param {any} content */
  message(content) {
    const { lesson } = this;
    switch (content.type) {
      case "task":
        this.waiting = "";
        this.presses.releaseAll();
        lesson.begin({ ...content, ...content.task, scene: SCENES[content.task.name] ?? content.task.scene });
        lesson.ready = true;
        this.pair = 0;
        this.presses.repeat = content.repeat || 8;
        this.stage.build(lesson.task);
        this.pads.build(lesson.task, 0);
        return this.changed();
      case "state":
        Object.assign(lesson.state, content);
        if (content.paused) this.presses.releaseAll();
        return this.changed();
      case "frame": {
        const fresh = lesson.frame !== null && lesson.frame.episode !== content.episode;
        lesson.frame = content;
        this.stage.step(content, fresh);
        document.documentElement.dataset.episode = String(content.episode);
        return this.painter.need("numbers");
      }
      case "advised":
        lesson.learned(content);
        this.stage.advised(content.id);
        return this.advised(content);
      case "episode":
        this.last = content.total;
        return this.painter.need("numbers");
      case "needed":
        return this.needed(content.keys);
      case "waiting":
        this.waiting = content.text;
        return this.changed();
      case "held":
        this.held = content.on;
        return this.changed();
    }
  }

  /** @param {any} advised */
  advised({ dim, h, before, after }) {
    const asked = capital(words(this.lesson.task, dim, h));
    say(byId("said"), `${asked} here: ${fixed(before, 2)} → ${fixed(after, 2)}`);
    byId("said").dataset.kind = h < 0 ? "less" : "more";
  }

  needed(keys) {
    const left = keys.filter((key) => key.left > 0);
    byId("needed").hidden = left.length === 0;
    const named = left.map(({ dim, h, left: count }) => {
      const [glyph] = [...arrows(this.lesson.task, Math.floor(dim / 2))].filter(([, each]) => each.dim === dim && each.h === h).map(([arrow]) => GLYPHS[arrow]);
      return `${glyph} ${words(this.lesson.task, dim, h)} (${count} more)`;
    });
    say(byId("needed"), `Press while it runs: ${named.join(", ")}`);
  }

  numbers() {
    const { frame } = this.lesson;
    if (!frame || !this.step) return;
    const parts = [`Episode ${Math.min(frame.episode + 1, this.step.episodes)} of ${this.step.episodes}`, `return ${short(frame.total)}`];
    if (this.last !== null) parts.push(`last ${short(this.last)}`);
    say(byId("work-numbers"), parts.join(" · "));
  }

  /** The card, as it is now. */
  changed() {
    clearTimeout(this.counting);
    if (!this.step) return;
    const card = this.card();
    byId("card").hidden = card === null;
    byId("rest").style.visibility = this.running ? "" : "hidden"; // its place stays, and the scene its size
    document.documentElement.dataset.phase = this.running ? "teaching" : "paused";
    if (!card) return;
    say(byId("card-title"), card.title);
    say(byId("card-text"), card.text);
    say(byId("card-button"), card.button ?? "");
    byId("card-button").hidden = !card.button;
    byId("card-busy").hidden = !card.busy;
    byId("card-keys").replaceChildren(...(card.keys ? this.keys() : []));
    say(byId("live"), `${card.title}. ${card.text}`);
  }

  keys() {
    return [...arrows(this.lesson.task, 0)].map(([arrow, { dim, h }]) =>
      element("p", {}, element("kbd", {}, GLYPHS[arrow]), element("kbd", {}, LETTERS[arrow]), ` ${words(this.lesson.task, dim, h)}`));
  }

  /** @returns {{title: string, text: string, button?: string, busy?: boolean, keys?: boolean}|null} */
  card() {
    const { lesson } = this;
    if (this.held) return { title: "Paused by the experimenter", text: "Please wait. Nothing is lost." };
    if (this.waiting) return { title: "Please wait", text: this.waiting, busy: true };
    if (!lesson.task || !lesson.ready) return { title: "Preparing", text: "A moment.", busy: true };
    if (!lesson.state.paused) return null;
    if (lesson.state.why === "over") return { title: "This run is over", text: "It is being saved. A moment.", busy: true };
    if (lesson.state.why !== "start") {
      const [title, text] = PAUSED[lesson.state.why] ?? PAUSED.you;
      return { title, text, button: lesson.state.why === "problem" ? "Try again" : "Go on" };
    }
    const left = Math.ceil((this.restUntil - performance.now()) / 1000);
    if (left > 0) {
      this.counting = setTimeout(() => this.changed(), 250);
      return { title: this.heading(), text: `${this.what()} A short rest: ${left} s.`, keys: true };
    }
    return { title: this.heading(), text: this.what(), button: "Begin", keys: true };
  }

  heading() {
    const { step } = this;
    if (step.kind === "trial") return step.attempt > 1 ? `Trial, attempt ${step.attempt} of ${step.attempts}` : "A trial";
    return `Run ${step.number} of ${step.of}: learner ${step.letter}, ${step.recorded ? "this one counts" : "practice"}`;
  }

  what() {
    const { step } = this;
    if (step.kind === "trial") {
      const goal = step.passes === "keys" ? `Press each key ${step.presses === 1 ? "once" : `${step.presses} times`} while it runs.` : `Teach it until an episode returns ${short(step.total)} or more.`;
      return `${hintOf(this.lesson.task)} ${goal}`;
    }
    return `${this.passed ? "You have passed the trial. " : ""}${hintOf(this.lesson.task)} ${counted(step.episodes, "episode")}, ${counted(Math.round(step.seconds / 6) / 10, "minute")} at most. It begins with nothing.`;
  }
}
