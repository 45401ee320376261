// What is held down, by keys, fingers and gamepads: one press at once, and repetitions while it lasts.

const BEFORE_REPEAT = 300;

export class Presses {
  /**
   * @param {(dim: number, h: number, held: boolean, at: number) => void} press one advice
   * @param {(dim: number, h: number, on: boolean) => void} light shows that it is held
   */
  constructor(press, light) {
    this.press = press;
    this.light = light;
    /** Repetitions a second. */
    this.repeat = 5;
    /** What is held in each dimension. @type {Map<number, {source: string, h: number, timer: number}>} */
    this.held = new Map();
    addEventListener("blur", () => this.releaseAll());
    document.addEventListener("visibilitychange", () => document.hidden && this.releaseAll());
  }

  /** @param {string} source key, pointer or gamepad button @param {number} dim @param {number} h @param {number} at ms */
  hold(source, dim, h, at) {
    const before = this.held.get(dim);
    if (before) this.end(dim, before);
    const hold = { source, h, timer: 0 };
    this.held.set(dim, hold);
    this.light(dim, h, true);
    this.press(dim, h, false, at);
    if (this.held.get(dim) === hold) this.later(dim, hold, performance.now() + BEFORE_REPEAT);
  }

  /** The next repetition at a time of the clock, so that late timers do not add up. */
  later(dim, hold, due) {
    hold.timer = setTimeout(() => {
      const now = performance.now();
      this.press(dim, hold.h, true, now);
      const period = 1000 / this.repeat;
      if (this.held.get(dim) === hold) this.later(dim, hold, Math.max(due + period, now + period / 2));
    }, due - performance.now());
  }

  /** @param {string} source */
  release(source) {
    for (const [dim, hold] of this.held) if (hold.source === source) this.end(dim, hold);
  }

  releaseAll() {
    for (const [dim, hold] of this.held) this.end(dim, hold);
  }

  end(dim, hold) {
    clearTimeout(hold.timer);
    this.held.delete(dim);
    this.light(dim, hold.h, false);
  }
}
