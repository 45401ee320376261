// Puts the page together: what the server tells goes to what shows it, what the person does goes to the server.

import { followTheme, Painter } from "./canvas.js";
import { Connection } from "./connection.js";
import { arrows, pairs } from "./controls.js";
import { Curve } from "./curve.js";
import { Dialogs } from "./dialogs.js";
import { byId, counted, say, short } from "./format.js";
import { listenToGamepads } from "./gamepad.js";
import { keepFocusOnClick, listenToKeys } from "./keys.js";
import { Lesson } from "./lesson.js";
import { PolicyMap } from "./map.js";
import { Notices } from "./notices.js";
import { Pads } from "./pads.js";
import { Panels } from "./panels.js";
import { Presses } from "./presses.js";
import { Replay } from "./replay.js";
import { Stage } from "./stage.js";
import { Transport } from "./transport.js";

const lesson = new Lesson();
const painter = new Painter();
followTheme(() => {
  map.paint();
  if (lesson.task) map.legend();
  painter.need(...painter.parts.keys());
});

const connection = new Connection({ message, picture: (_, image) => stage.scene?.picture?.(image), status });
const notices = new Notices(lesson);
const stage = new Stage(painter, lesson, (action, advice) => pads.draw(action, advice));
const panels = new Panels(painter, lesson);
const curve = new Curve(painter, () => lesson.history);
const map = new PolicyMap(painter, lesson, (axes) => connection.send("map", axes));
const replay = new Replay(painter, (text) => notices.happened(text));
const pads = new Pads({
  hold: (source, dim, h, at) => presses.hold(source, dim, h, at),
  release: (source) => presses.release(source),
  choose,
});
const presses = new Presses(press, (dim, h, on) => pads.light(dim, h, on));
const transport = new Transport(lesson, { send: (type, content) => connection.send(type, content), command });
const dialogs = new Dialogs({
  begin: (name, settings) => connection.send("learner", { name, settings }),
  save: (name) => connection.send("save", { name }),
  open: (name) => connection.send("open", { name }),
  opened: () => presses.releaseAll(),
});

/** Which pair of the action's dimensions the arrows act on. */
let pair = 0;
let pressed = 0;
/** Marks of the browser's clock are kept for so many advices. */
const MARKS = 1000;
/** Advices after which no step was shown yet. @type {{id: number, n: number}[]} */
let unfollowed = [];

/** @param {number} dim @param {number} h @param {boolean} held @param {number} at */
function press(dim, h, held, at) {
  const { state, frame, phase } = lesson;
  if (!lesson.teachable) {
    if (held) return;
    if (phase === "run" || state.mode === "run") notices.happened("Nothing is learned while it runs. L to teach again.");
    else if (phase === "preparing") notices.happened("Not ready yet: a moment.");
    return;
  }
  const id = ++pressed;
  performance.mark(`press-${id}`, { startTime: at });
  if (id > MARKS) for (const kind of ["press", "advised", "drawn", "followed"]) performance.clearMarks(`${kind}-${id - MARKS}`);
  // The first advice starts the task; a press while the person paused is about the step that is shown.
  if (state.paused && state.why !== "you") connection.send("pause", { on: false });
  connection.send("press", { id, dim, h, n: frame?.n ?? 0, at, held });
}

/** @param {import("./controls.js").Arrow} arrow @param {string} source @param {number} at */
function arrowPressed(arrow, source, at) {
  const advice = lesson.task && !dialogs.isOpen ? arrows(lesson.task, pair).get(arrow) : undefined;
  if (!advice) return false;
  presses.hold(source, advice.dim, advice.h, at);
  return true;
}

/** @param {number} index */
function choose(index) {
  if (!lesson.task || index >= pairs(lesson.task) || index === pair) return;
  presses.releaseAll();
  pair = dialogs.pair = index;
  const focused = document.activeElement?.closest(".pairs") ? index : -1;
  pads.build(lesson.task, pair);
  if (focused >= 0) byId("pads").querySelectorAll(".pairs button")[focused].focus();
  painter.need("scene");
}

/** @param {string} name of a key's or a button's command */
function command(name) {
  if (dialogs.isOpen) return;
  if (name === "help" || name === "files" || name === "anew") dialogs.open(name);
  else if (name === "replay") replay.toggle();
  else if (name === "axes") map.next();
  else if (lesson.phase === "taken" && name === "go") takeOver();
  else transport.command(name);
}

function takeOver() {
  lesson.taken = false;
  connection.take();
  changed();
}

/** The phase, or something that is shown of it, may be another one. */
function changed() {
  const { phase } = lesson;
  if (phase !== "teaching" && phase !== "waiting" && phase !== "paused") presses.releaseAll();
  notices.show(phase);
  transport.show();
}

/** @param {"open"|"lost"} to */
function status(to) {
  lesson.connected = to === "open";
  lesson.everConnected ||= lesson.connected;
  if (lesson.connected) lesson.reason = "";
  changed();
}

/** @param {any} task */
function begin(task) {
  presses.releaseAll();
  const same = lesson.task?.name === task.name;
  const axes = same ? { ...map.axes } : null;
  lesson.begin(task);
  unfollowed = [];
  document.body.classList.remove("no-task");
  pair = dialogs.pair = 0;
  presses.repeat = task.repeat || 5;
  say(byId("task-label"), task.label || task.name);
  say(byId("learner-label"), task.learner.label || task.learner.name);
  byId("open-anew").hidden = false;
  for (const part of [notices, stage, panels, replay, dialogs]) part.build(task);
  pads.build(task, pair);
  map.build(task, axes);
  painter.need("curve", "step", "learner");
  changed();
}

/** @param {any} frame */
function frameCame(frame) {
  const fresh = lesson.frame !== null && lesson.frame.episode !== frame.episode;
  lesson.frame = frame;
  for (const { id, n } of unfollowed) if (frame.n > n) performance.mark(`followed-${id}`);
  unfollowed = unfollowed.filter(({ n }) => frame.n <= n);
  stage.step(frame, fresh);
  replay.step(frame, fresh);
  painter.need("step", "map now");
}

/** @param {any} ended */
function episodeEnded(ended) {
  lesson.history.add(ended);
  painter.need("curve");
  const what = ended.mode === "run" ? "Evaluation" : `Episode ${lesson.history.count}`;
  const how = `${counted(ended.steps, "step")}, ${ended.mode === "run" ? "nothing learned" : counted(ended.corrections, "correction")}`;
  notices.happened(`${what} ended${ended.why === "reset" ? " by you" : ""} with ${short(ended.total)} (${how}).`);
}

/** @param {any} content */
function advised(content) {
  performance.mark(`advised-${content.id}`);
  unfollowed.push(content);
  lesson.learned(content);
  notices.advised(content, lesson.task);
  stage.advised(content.id);
  transport.showUndos();
  painter.need("learner");
}

/** @param {any} content */
function message(content) {
  switch (content.type) {
    case "hello":
      lesson.taken = content.taken;
      return changed();
    case "gone":
      lesson.reason = content.reason ?? "";
      lesson.taken = connection.stays;
      lesson.connected &&= lesson.taken;
      return changed();
    case "task":
      // What it is about and how it is taught, as one thing.
      return begin({ ...content, ...content.task });
    case "preparing":
      lesson.preparing = content.what;
      lesson.ready = false;
      return changed();
    case "ready":
      lesson.ready = true;
      return changed();
    case "state":
      Object.assign(lesson.state, content);
      return changed();
    case "frame":
      return frameCame(content);
    case "advised":
      return advised(content);
    case "undone":
      lesson.unlearned(content);
      transport.showUndos();
      painter.need("learner", "scene");
      return notices.happened(`The last advice is undone: ${counted(content.corrections, "correction")} left.`);
    case "episode":
      return episodeEnded(content);
    case "lines":
      lesson.history.lines = content;
      return painter.need("curve");
    case "map":
      return map.take(content);
    case "saved":
      dialogs.saved(content.saves);
      return notices.happened(`Saved as ${content.name}.`);
    case "problem":
      lesson.trouble = content.text;
      notices.happened(content.text, "problem");
      return changed();
    case "pong":
      return transport.foot(connection.roundTrip);
  }
}

byId("card-button").addEventListener("click", () => command("go"));
listenToKeys({
  arrow: arrowPressed,
  release: (source) => presses.release(source),
  command,
  digit: choose,
  pad: (button, source, at) => pads.press(button, source, at),
});
listenToGamepads({ arrow: arrowPressed, release: (source) => presses.release(source), command });
keepFocusOnClick();
changed();
connection.open();
