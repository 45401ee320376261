// What the server told, and what follows of it: in which phase the lesson is.

import { History } from "./history.js";

/** @typedef {"connecting"|"preparing"|"waiting"|"teaching"|"paused"|"run"|"taken"|"lost"|"problem"} Phase */

export class Lesson {
  constructor() {
    this.connected = false;
    this.everConnected = false;
    this.taken = false;
    this.reason = "";
    this.trouble = "";
    this.forget();
  }

  /** Before the first task, and whenever another one begins. */
  forget() {
    /** @type {any} */
    this.task = null;
    this.preparing = "";
    this.ready = false;
    this.state = { mode: "teach", paused: true, why: "start", speed: 1, undos: 0 };
    /** @type {any} */
    this.frame = null;
    /** @type {any} */
    this.advised = null;
    this.advisedAt = -Infinity;
    this.corrections = 0;
    this.rate = null;
    /** @type {number[]|null} */
    this.points = null;
    this.history = new History();
    /** @type {any} */
    this.map = null;
  }

  /** @returns {Phase} */
  get phase() {
    if (this.taken) return "taken";
    if (!this.connected) return this.everConnected ? "lost" : "connecting";
    if (!this.task) return "connecting";
    if (this.state.why === "problem" && this.state.paused) return "problem";
    if (!this.ready) return "preparing";
    if (this.state.paused) return this.state.why === "start" ? "waiting" : "paused";
    return this.state.mode === "run" ? "run" : "teaching";
  }

  /** Advice would reach a policy that learns from it. */
  get teachable() {
    const { mode, paused, why } = this.state;
    return this.connected && !this.taken && this.ready && mode === "teach" && !(paused && why === "problem");
  }

  /** @param {any} task */
  begin(task) {
    const { trouble } = this;
    this.forget();
    this.trouble = trouble;
    this.task = task;
    this.taken = false;
    this.corrections = task.corrections ?? 0;
    this.points = task.points ?? null;
    this.rate = task.rate ?? null;
    for (const episode of task.episodes ?? []) this.history.add(episode);
    if (task.lines) this.history.lines = task.lines;
  }

  /** @param {any} message `advised` */
  learned(message) {
    this.advised = message;
    this.advisedAt = performance.now();
    this.rate = message.rate;
    this.points = message.points;
    this.corrections = message.corrections;
    this.state.undos = message.undos;
  }

  /** @param {any} message `undone` */
  unlearned(message) {
    this.points = message.points;
    this.corrections = message.corrections;
    this.state.undos = message.undos;
    this.advisedAt = -Infinity;
  }
}
