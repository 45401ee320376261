// Returns of the episodes so far, bounded: pages stay open for hours.

const MOST = 10000;

/** @typedef {{x: number, total: number, corrections: number}} Point `x`: how many taught episodes there were, from 1 */

export class History {
  constructor() {
    /** @type {Point[]} */
    this.taught = [];
    /** Evaluations, at the place of the taught episode before them. @type {Point[]} */
    this.runs = [];
    this.count = 0;
    /** @type {{oracle: ?number, idle: ?number}} */
    this.lines = { oracle: null, idle: null };
  }

  /** @param {{total: number, corrections: number, mode: string}} episode */
  add(episode) {
    const run = episode.mode === "run";
    if (!run) this.count += 1;
    const kept = run ? this.runs : this.taught;
    kept.push({ x: this.count, total: episode.total, corrections: episode.corrections });
    if (kept.length > MOST) thin(kept);
  }
}

/** Leaves out every second point of the older half, in place. @param {Point[]} points */
function thin(points) {
  const half = points.length >> 1;
  let to = 0;
  for (let from = 0; from < points.length; from++) {
    if (from >= half || from % 2 === 0) points[to++] = points[from];
  }
  points.length = to;
}
