// The first episode beside the present one, over and over, at the task's own pace.

import { Board } from "./canvas.js";
import { byId, say } from "./format.js";
import { makeScene } from "./scenes.js";

const MOST = 10000;
/** Seconds for which its end is shown. */
const REST = 1;

export class Replay {
  /** @param {import("./canvas.js").Painter} painter @param {(text: string) => void} tell */
  constructor(painter, tell) {
    this.painter = painter;
    this.tell = tell;
    this.root = byId("first");
    this.button = byId("replay");
    this.board = new Board(byId("first-canvas"), () => painter.need("first"));
    this.words = byId("first-step");
    /** @type {any} */
    this.task = null;
    /** @type {number[][]} */
    this.steps = [];
    this.whole = false;
    this.on = false;
    this.since = 0;
    this.shown = -1;
    byId("first-close").addEventListener("click", () => this.toggle(false));
    painter.add("first", () => this.draw());
  }

  /** @param {any} task */
  build(task) {
    this.task = task;
    this.steps = (task.first ?? []).slice(0, MOST);
    // An episode that is not the first one is not kept in its place.
    this.whole = this.steps.length > 0 || (task.episodes ?? []).length > 0;
    this.scene = task.scene === "pictures" ? null : makeScene(task, () => {});
    this.button.hidden = !this.scene;
    this.toggle(false);
  }

  /** Keeps the first episode while it happens, where the server had none yet. @param {any} frame @param {boolean} fresh */
  step(frame, fresh) {
    if (this.whole || !this.scene) return;
    if (fresh && this.steps.length) this.whole = true;
    else if (this.steps.length < MOST) this.steps.push(frame.obs);
  }

  /** @param {boolean} [on] */
  toggle(on = !this.on) {
    if (on && (!this.whole || !this.steps.length)) {
      this.tell(this.whole ? "The first episode was not kept." : "The first episode can be replayed once it has ended.");
      return;
    }
    this.on = on;
    this.root.hidden = !on;
    this.button.setAttribute("aria-pressed", String(on));
    this.since = performance.now();
    this.shown = -1;
    if (on) this.painter.need("first");
  }

  draw() {
    if (!this.on || !this.scene) return;
    const seconds = this.task.step;
    const long = this.steps.length * seconds + REST;
    const now = ((performance.now() - this.since) / 1000) % long;
    const step = Math.min(this.steps.length - 1, Math.floor(now / seconds));
    if (step < this.shown) this.scene.clear?.();
    if (step !== this.shown || this.board.canvas.width !== Math.round(this.board.width * this.board.ratio)) {
      this.shown = step;
      this.scene.push?.(this.steps[step], []);
      const context = this.board.begin();
      const view = { obs: this.steps[step], action: [], advice: null, small: true };
      if (context) this.scene.draw(context, this.board.width, this.board.height, view);
      say(this.words, `${step + 1}/${this.steps.length}`);
    }
    this.painter.need("first");
  }
}
