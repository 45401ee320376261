// Gamepads: looked at in each animation frame, and only while there is one.

const FAR = 0.5;
/** Of the standard layout. @type {[number, import("./controls.js").Arrow][]} */
const CROSS = [[12, "up"], [13, "down"], [14, "left"], [15, "right"]];

/**
 * @param {object} to
 * @param {(arrow: import("./controls.js").Arrow, source: string, at: number) => void} to.arrow
 * @param {(source: string) => void} to.release
 * @param {(command: string) => void} to.command
 */
export function listenToGamepads(to) {
  /** Sources that are down. */
  const down = new Set();
  let polling = false;

  const set = (source, on, begin) => {
    if (on === down.has(source)) return;
    if (on) {
      down.add(source);
      begin(source);
    } else {
      down.delete(source);
      to.release(source);
    }
  };

  const look = () => {
    const pads = navigator.getGamepads().filter((pad) => pad?.connected);
    for (const pad of pads) {
      const [x = 0, y = 0] = pad.axes;
      const stick = { left: x < -FAR, right: x > FAR, up: y < -FAR, down: y > FAR };
      for (const [button, arrow] of CROSS) {
        const on = stick[arrow] || (pad.buttons[button]?.pressed ?? false);
        set(`pad${pad.index}${arrow}`, on, (source) => to.arrow(arrow, source, performance.now()));
      }
      set(`pad${pad.index}go`, pad.buttons[0]?.pressed ?? false, () => to.command("go"));
      set(`pad${pad.index}undo`, pad.buttons[1]?.pressed ?? false, () => to.command("undo"));
    }
    polling = pads.length > 0;
    if (polling) {
      requestAnimationFrame(look);
    } else {
      for (const source of down) to.release(source);
      down.clear();
    }
  };

  addEventListener("gamepadconnected", () => {
    if (polling) return;
    polling = true;
    requestAnimationFrame(look);
  });
}
