// The keyboard. Keys typed in a field, in a dialog, or with Ctrl, Alt or Meta are not ours.

/** @typedef {import("./controls.js").Arrow} Arrow */

/** @type {Record<string, Arrow>} */
const ARROWS = {
  arrowleft: "left", arrowright: "right", arrowup: "up", arrowdown: "down", a: "left", d: "right", w: "up", s: "down",
};

/** Keys of one command each, as `event.key` in lower case. */
const COMMANDS = {
  " ": "go", ".": "step", r: "reset", u: "undo", backspace: "undo", "+": "faster", "=": "faster", "-": "slower", l: "run",
  m: "axes", v: "replay", "?": "help", o: "files", n: "anew",
};

/** For the dialog of help; the advice's keys come from the task. */
export const KEYS = [
  [["Space"], "start, pause, go on"],
  [["."], "one step, while paused"],
  [["U", "⌫"], "undo the last advice, and those before"],
  [["R"], "end the episode and begin another"],
  [["+", "−"], "faster, slower"],
  [["L"], "let it run: nothing is learned; again: teach on"],
  [["M"], "other axes of the map"],
  [["V"], "replay the first episode beside this one"],
  [["O"], "save or open"],
  [["N"], "begin anew, with another learner"],
  [["?"], "this help"],
];

/** The letter on a key, also where the layout has no Latin letters. @param {KeyboardEvent} event */
function named(event) {
  const { key, code } = event;
  if (key.length === 1 && key > "~" && /^Key[A-Z]$/.test(code)) return code.slice(3).toLowerCase();
  return key.toLowerCase();
}

/** Fields that take keys for themselves. @param {EventTarget|null} target */
function takesKeys(target) {
  return target instanceof HTMLElement && (target.matches("input, select, textarea") || target.closest("dialog") !== null);
}

/**
 * @param {object} to
 * @param {(arrow: Arrow, source: string, at: number) => boolean} to.arrow whether it means something
 * @param {(source: string) => void} to.release
 * @param {(command: string) => void} to.command
 * @param {(index: number) => void} to.digit
 * @param {(button: HTMLElement, source: string, at: number) => void} to.pad a touch button that has the focus
 */
export function listenToKeys(to) {
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || takesKeys(event.target)) return;
    const key = named(event);
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    if (button && (key === " " || key === "enter")) {
      // A button that has the focus is pressed by these keys; a button of advice may be held.
      if (!button.classList.contains("pad")) return;
      event.preventDefault();
      if (!event.repeat) to.pad(button, event.code, event.timeStamp);
    } else if (key in ARROWS) {
      if (event.repeat) event.preventDefault();
      else if (to.arrow(ARROWS[key], event.code, event.timeStamp)) event.preventDefault();
    } else if (key in COMMANDS) {
      event.preventDefault();
      const again = key === "+" || key === "=" || key === "-" || key === ".";
      if (!event.repeat || again) to.command(COMMANDS[key]);
    } else if (key >= "1" && key <= "9" && key.length === 1 && !event.repeat) {
      to.digit(Number(key) - 1);
    }
  });
  addEventListener("keyup", (event) => to.release(event.code));
}

/** A button that was clicked does not take the focus: Space shall still pause, not click it once more. */
export function keepFocusOnClick() {
  document.addEventListener("mousedown", (event) => {
    if (event.target instanceof Element && event.target.closest("main button, header button")) event.preventDefault();
  });
  // A select or slider that was used by pointer gives the arrows back to advice; one used by keys keeps them.
  let byPointer = false;
  addEventListener("pointerdown", () => (byPointer = true), true);
  addEventListener("keydown", () => (byPointer = false), true);
  document.addEventListener("change", (event) => {
    if (byPointer && event.target instanceof HTMLElement && event.target.matches("main select, main input")) event.target.blur();
  });
}
