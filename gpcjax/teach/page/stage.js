// The scene in the middle: the present step, the arrow of its action, what the last advice did, and how sure the policy is.

import { Board, still } from "./canvas.js";
import { byId, say } from "./format.js";
import { makeScene } from "./scenes.js";

/** For how long an advice is shown, and from when it fades, in ms. */
const SHOWN = 1600;
const FADES = 900;

export class Stage {
  /** @param {import("./canvas.js").Painter} painter @param {import("./lesson.js").Lesson} lesson
   *  @param {(action: number[], advice: import("./scenes.js").Advice|null) => void} drawn */
  constructor(painter, lesson, drawn) {
    this.painter = painter;
    this.lesson = lesson;
    this.drawn = drawn;
    this.canvas = byId("scene-canvas");
    this.board = new Board(this.canvas, () => painter.need("scene"));
    /** @type {import("./scenes.js").Scene|null} */
    this.scene = null;
    this.unsure = 1;
    this.nodes = { box: byId("sure"), fill: byId("sure-fill"), word: byId("sure-word") };
    /** Advices whose effect the next animation frame shows. @type {number[]} */
    this.undrawn = [];
    painter.add("scene", () => this.draw());
  }

  /** @param {any} task */
  build(task) {
    this.scene = makeScene(task, () => this.painter.need("scene"));
    this.canvas.setAttribute("aria-label", `${task.label}, as it is now`);
    this.unsure = 1;
    this.nodes.box.hidden = true;
    this.painter.need("scene");
  }

  /** @param {any} frame @param {boolean} fresh another episode */
  step(frame, fresh) {
    if (fresh) this.scene?.clear?.();
    this.scene?.push?.(frame.obs, frame.action);
    this.sure(frame);
    this.painter.need("scene");
  }

  /** @param {number} id */
  advised(id) {
    this.undrawn.push(id);
    if (this.undrawn.length > 200) this.undrawn.shift();
    this.painter.keep("scene", SHOWN);
  }

  /** @returns {import("./scenes.js").Advice|null} */
  get advice() {
    const { advised, advisedAt } = this.lesson;
    const age = performance.now() - advisedAt;
    if (!advised || age > SHOWN) return null;
    const strength = still.matches || age < FADES ? 1 : 1 - (age - FADES) / (SHOWN - FADES);
    return { dim: advised.dim, h: advised.h, before: advised.before, after: advised.after, strength };
  }

  draw() {
    const { frame } = this.lesson;
    const context = this.board.begin();
    if (!context || !this.scene || !frame) return;
    const { advice } = this;
    this.scene.draw(context, this.board.width, this.board.height, { obs: frame.obs, action: frame.action, advice, small: false });
    this.drawn(frame.action, advice);
    for (const id of this.undrawn) performance.mark(`drawn-${id}`);
    this.undrawn.length = 0;
  }

  /** A quiet word where the policy knows little: advice is worth most there (thesis 3.4.2). @param {any} frame */
  sure({ sigma, prior }) {
    const known = sigma !== null && prior;
    if (this.nodes.box.hidden === Boolean(known)) this.nodes.box.hidden = !known;
    if (!known) return;
    const now = Math.min(1, Math.max(...sigma) / prior);
    // Smoothed over a few steps, else the word flickers.
    this.unsure += (now - this.unsure) * 0.2;
    this.nodes.fill.style.transform = `scaleX(${this.unsure.toFixed(2)})`;
    say(this.nodes.word, this.unsure > 0.85 ? "untaught here" : this.unsure > 0.5 ? "unsure here" : "sure here");
    this.nodes.box.dataset.level = this.unsure > 0.5 ? "unsure" : "sure";
  }
}
