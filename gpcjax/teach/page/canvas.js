// Canvases that are sharp on any display, the colours of the theme, and one animation frame for all that changed.

/** A canvas whose backing store follows its size in device pixels; measured by an observer, never while drawing. */
export class Board {
  /** @param {HTMLCanvasElement} canvas @param {() => void} changed called when it must be drawn again */
  constructor(canvas, changed) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.width = this.height = 0;
    this.ratio = 1;
    new ResizeObserver(([entry]) => {
      this.width = entry.contentRect.width;
      this.height = entry.contentRect.height;
      this.ratio = Math.min(3, window.devicePixelRatio || 1);
      changed();
    }).observe(canvas);
  }

  /** Cleared, in units of CSS pixels; null while it has no size. @returns {CanvasRenderingContext2D|null} */
  begin() {
    if (this.width < 1 || this.height < 1) return null;
    const wide = Math.round(this.width * this.ratio);
    const high = Math.round(this.height * this.ratio);
    // Setting a size clears the canvas and drops its store: only when it differs, and only where it is drawn at once.
    if (this.canvas.width !== wide || this.canvas.height !== high) {
      this.canvas.width = wide;
      this.canvas.height = high;
    }
    this.context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.context.clearRect(0, 0, this.width, this.height);
    return this.context;
  }
}

/** Calls what was asked to be drawn, in the order in which it was added, in the next animation frame. */
export class Painter {
  constructor() {
    /** @type {Map<string, () => void>} */
    this.parts = new Map();
    this.needed = new Set();
    this.asked = false;
    /** Parts that move by themselves: name -> the time until which they do. @type {Map<string, number>} */
    this.moving = new Map();
    this.frame = this.frame.bind(this);
  }

  /** @param {string} name @param {() => void} paint */
  add(name, paint) {
    this.parts.set(name, paint);
    this.need(name);
  }

  /** @param {...string} names */
  need(...names) {
    for (const name of names) this.needed.add(name);
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(this.frame);
  }

  /** Draws a part in each frame for some time. @param {string} name @param {number} milliseconds */
  keep(name, milliseconds) {
    this.moving.set(name, performance.now() + milliseconds);
    this.need(name);
  }

  /** @param {number} now */
  frame(now) {
    this.asked = false;
    const due = new Set(this.needed);
    this.needed.clear();
    for (const [name, paint] of this.parts) if (due.has(name)) paint();
    for (const [name, until] of this.moving) {
      if (now > until) this.moving.delete(name);
      this.need(name);
    }
  }
}

const NAMES = ["ink", "muted", "line", "surface", "ground", "less", "more", "run", "body", "faint", "sky"];
const dark = matchMedia("(prefers-color-scheme: dark)");

/** The colours of the style sheet, by name. @type {Record<string, string>} */
export const colours = {};

/** The 255 colours of a policy's map, -127 to 127, as packed pixels (ABGR, as a little-endian machine keeps RGBA). */
export const diverging = new Uint32Array(255);

export const still = matchMedia("(prefers-reduced-motion: reduce)");

function read() {
  const style = getComputedStyle(document.documentElement);
  for (const name of NAMES) colours[name] = style.getPropertyValue(`--${name}`).trim();
  // Blue and orange with a neutral middle: told apart by all common kinds of colour blindness, and by lightness.
  const [low, middle, high] = dark.matches
    ? [[86, 170, 250], [27, 32, 39], [250, 156, 66]]
    : [[33, 102, 172], [247, 247, 245], [200, 92, 6]];
  for (let index = 0; index < 255; index++) {
    const value = (index - 127) / 127;
    const end = value < 0 ? low : high;
    const part = Math.abs(value) ** 0.85;
    const [red, green, blue] = end.map((each, k) => Math.round(middle[k] + (each - middle[k]) * part));
    diverging[index] = (255 << 24) | (blue << 16) | (green << 8) | red;
  }
}

/** Reads the colours, now and whenever the theme changes. @param {() => void} changed */
export function followTheme(changed) {
  read();
  dark.addEventListener("change", () => {
    read();
    changed();
  });
}

/** @param {CanvasRenderingContext2D} context @param {number} size @param {string} [weight] */
export function font(context, size, weight = "400") {
  context.font = `${weight} ${size}px system-ui, "Segoe UI", Roboto, "Liberation Sans", sans-serif`;
}
