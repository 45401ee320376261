// Which arrow means what, and where the buttons of an action's dimension stand.

/** @typedef {"left"|"right"|"up"|"down"} Arrow @typedef {{dim: number, h: -1|1}} Advice */

export const GLYPHS = { left: "←", right: "→", up: "↑", down: "↓" };
export const LETTERS = { left: "A", right: "D", up: "W", down: "S" };
export const LABELS = { left: "left arrow", right: "right arrow", up: "up arrow", down: "down arrow" };

/** What the task says of itself, or what it does where it says nothing. @type {Record<string, string>} */
const HINTS = {
  pendulum: "Swing the rod up and hold it there.",
  cartpole: "Keep the pole upright.",
  mountaincar: "Drive the car up to the flag.",
};

/** @param {any} task */
export const hintOf = (task) => task.hint || HINTS[task.scene] || "Make it do what you want.";

/** How many pairs of dimensions there are; the arrows act on one of them. @param {any} task */
export const pairs = (task) => Math.ceil(task.actions.length / 2);

/** The dimensions of a pair. @param {any} task @param {number} pair @returns {number[]} */
export function dimensions(task, pair) {
  return [2 * pair, 2 * pair + 1].filter((dim) => dim < task.actions.length);
}

/**
 * What the arrows mean: as the task says, where it says so without using one twice; else the first dimension of the
 * pair is left and right, the second down and up.
 * @param {any} task @param {number} pair @returns {Map<Arrow, Advice>}
 */
export function arrows(task, pair) {
  const dims = dimensions(task, pair);
  const given = dims.flatMap((dim) => [
    [task.actions[dim].less.key, { dim, h: -1 }],
    [task.actions[dim].more.key, { dim, h: 1 }],
  ]);
  const keys = given.map(([key]) => key);
  if (keys.every((key) => key in GLYPHS) && new Set(keys).size === keys.length) {
    return new Map(given.sort(([a], [b]) => Number(first(b)) - Number(first(a))));
  }
  const usual = [["left", "right"], ["down", "up"]];
  return new Map(dims.flatMap((dim, k) => [[usual[k][0], { dim, h: -1 }], [usual[k][1], { dim, h: 1 }]]));
}

/**
 * The two buttons of a dimension, from left to right: the one with the arrow to the left (or down) comes first.
 * @param {any} task @param {number} pair @param {number} dim
 * @returns {{h: -1|1, key: Arrow, words: string}[]}
 */
export function buttons(task, pair, dim) {
  const found = /** @type {{h: -1|1, key: Arrow, words: string}[]} */ ([]);
  for (const [key, advice] of arrows(task, pair)) {
    if (advice.dim !== dim) continue;
    const side = advice.h < 0 ? task.actions[dim].less : task.actions[dim].more;
    found.push({ h: advice.h, key, words: side.words || (advice.h < 0 ? "less" : "more") });
  }
  return found.sort((a, b) => Number(first(b.key)) - Number(first(a.key)));
}

const first = (key) => key === "left" || key === "down";

/** What an advice asks for, in the task's words. @param {any} task @param {number} dim @param {number} h */
export function words(task, dim, h) {
  const action = task.actions[dim];
  const said = h < 0 ? action.less.words : action.more.words;
  return said || `${h < 0 ? "less" : "more"} ${action.name}`;
}
