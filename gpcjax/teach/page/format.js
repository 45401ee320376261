// Numbers and words as the page writes them.

const MINUS = "\u2212";

/** A number with a fixed count of decimals, a real minus and no "-0.00". @param {number} value @param {number} digits */
export function fixed(value, digits) {
  if (!Number.isFinite(value)) return "–";
  const text = Math.abs(value).toFixed(digits);
  return value < 0 && Number(text) !== 0 ? MINUS + text : text;
}

/** A number with three significant digits or so: 0.031, 12.4, 1,530. @param {number|null|undefined} value */
export function short(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size >= 1000) return (value < 0 ? MINUS : "") + Math.round(size).toLocaleString("en");
  if (size >= 100 || Number.isInteger(value)) return fixed(value, 0);
  if (size >= 10) return fixed(value, 1);
  if (size >= 0.1 || size === 0) return fixed(value, 2);
  return size >= 0.001 ? fixed(value, 4) : value.toExponential(1).replace("-", MINUS);
}

/** How many decimals tell four digits of a number that spans `range`. @param {number} range */
export function decimals(range) {
  if (!Number.isFinite(range) || range <= 0) return 4;
  return Math.min(6, Math.max(2, 4 - Math.floor(Math.log10(range))));
}

/** The range of an observation, or null where one of its ends is not known. @param {{low: ?number, high: ?number}} seen */
export function rangeOf(seen) {
  const { low, high } = seen;
  return Number.isFinite(low) && Number.isFinite(high) && low < high ? [low, high] : null;
}

/** "1 correction", "2 corrections". @param {number} count @param {string} noun */
export const counted = (count, noun) => `${count.toLocaleString("en")} ${noun}${count === 1 ? "" : "s"}`;

/** The first letter as a capital. @param {string} text */
export const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

/** An element with attributes and text; nothing is ever parsed as HTML.
 * @param {string} tag @param {Record<string, string>} [attributes] @param {...(Node|string)} children */
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

/** @param {string} id @returns {any} the element with this id */
export const byId = (id) => document.getElementById(id);

/** Sets a text only where it changes: an unchanged text costs no layout. @param {Element} node @param {string} text */
export function say(node, text) {
  if (node.textContent !== text) node.textContent = text;
}
