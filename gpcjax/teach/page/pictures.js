// Pictures that the task makes: the newest one that is decoded; those that come while one is decoded are left out.

import { drawCompass } from "./compass.js";

export class Pictures {
  /** @param {any} task @param {() => void} changed */
  constructor(task, changed) {
    this.task = task;
    this.changed = changed;
    /** @type {ImageBitmap|null} */
    this.bitmap = null;
    /** @type {Blob|null} */
    this.waiting = null;
    this.decoding = false;
  }

  /** @param {Blob} image */
  picture(image) {
    this.waiting = image;
    if (!this.decoding) this.decode();
  }

  async decode() {
    this.decoding = true;
    while (this.waiting) {
      const image = this.waiting;
      this.waiting = null;
      try {
        const bitmap = await createImageBitmap(image);
        this.bitmap?.close();
        this.bitmap = bitmap;
        this.changed();
      } catch {
        // A picture that is broken is left out: the one before it stays, and the numbers are there anyway.
      }
    }
    this.decoding = false;
  }

  /** @type {import("./scenes.js").Scene["draw"]} */
  draw(context, width, height, view) {
    if (this.bitmap) {
      const scale = Math.min(width / this.bitmap.width, height / this.bitmap.height);
      const [wide, high] = [this.bitmap.width * scale, this.bitmap.height * scale];
      context.imageSmoothingQuality = "high";
      context.drawImage(this.bitmap, (width - wide) / 2, (height - high) / 2, wide, high);
    }
    if (!view.small) drawCompass(context, width, height, this.task, view);
  }
}
