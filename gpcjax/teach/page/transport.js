// Start and pause, one step, undo, reset, speed, let it run: buttons and keys alike.

import { byId, fixed, say } from "./format.js";

export class Transport {
  /**
   * @param {import("./lesson.js").Lesson} lesson
   * @param {{send: (type: string, content?: object) => boolean, command: (name: string) => void}} to
   */
  constructor(lesson, to) {
    this.lesson = lesson;
    this.send = to.send;
    this.nodes = Object.fromEntries(
      ["go", "step", "undo", "undos", "reset", "speed", "speed-value", "run", "replay", "foot"].map((id) => [id, byId(id)]),
    );
    for (const name of ["go", "step", "undo", "reset", "run", "replay"]) {
      this.nodes[name].addEventListener("click", () => to.command(name));
    }
    this.nodes.speed.addEventListener("input", () => this.speed(Number(this.nodes.speed.value)));
  }

  /** @param {string} name */
  command(name) {
    const { state, ready, connected } = this.lesson;
    if (!ready || !connected) return;
    switch (name) {
      case "go":
        this.send("pause", { on: !state.paused });
        break;
      case "step":
        if (state.paused) this.send("step");
        break;
      case "undo":
        if (state.undos > 0) this.send("undo");
        break;
      case "reset":
        this.send("reset");
        break;
      case "run":
        this.send("run", { on: state.mode !== "run" });
        break;
      case "faster":
        this.speed(state.speed + 0.1);
        break;
      case "slower":
        this.speed(state.speed - 0.1);
    }
  }

  /** @param {number} value */
  speed(value) {
    const asked = Math.min(2, Math.max(0.1, Math.round(value * 10) / 10));
    this.lesson.state.speed = asked;
    this.showSpeed();
    this.send("speed", { value: asked });
  }

  show() {
    const { lesson, nodes } = this;
    const { state, ready, connected, taken } = lesson;
    const able = ready && connected && !taken;
    say(nodes.go, !state.paused ? "Pause" : state.why === "start" ? "Start" : "Go on");
    enable(nodes.go, able);
    enable(nodes.step, able && state.paused);
    enable(nodes.reset, able);
    enable(nodes.run, able);
    nodes.run.setAttribute("aria-pressed", String(state.mode === "run"));
    say(nodes.run, state.mode === "run" ? "Teach again" : "Let it run");
    this.showUndos();
    this.showSpeed();
  }

  showUndos() {
    const { state, ready, connected } = this.lesson;
    say(this.nodes.undos, state.undos.toLocaleString("en"));
    enable(this.nodes.undo, ready && connected && state.undos > 0);
  }

  showSpeed() {
    const { speed } = this.lesson.state;
    if (Number(this.nodes.speed.value) !== speed) this.nodes.speed.value = String(speed);
    say(this.nodes["speed-value"], `${fixed(speed, 1)}×`);
  }

  /** @param {number} roundTrip ms */
  foot(roundTrip) {
    const { task, frame, state } = this.lesson;
    if (!task) return;
    const pace = Math.round(state.speed / task.step);
    const late = frame && !state.paused && frame.late > 50 ? `; the machine is ${Math.round(frame.late)} ms late` : "";
    say(this.nodes.foot, `${pace} steps a second, ${Math.max(1, Math.round(roundTrip))} ms to the server and back${late}`);
  }
}

/** Not able, but still reached by Tab: a button that vanishes from under the focus loses it.
 * @param {HTMLElement} button @param {boolean} able */
function enable(button, able) {
  const value = String(!able);
  if (button.getAttribute("aria-disabled") !== value) button.setAttribute("aria-disabled", value);
}
