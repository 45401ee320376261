// The websocket: opened again when it breaks, watched by pings, JSON and pictures told apart.

const FIRST_WAIT = 500;
const LONGEST_WAIT = 5000;
const PING_EVERY = 2000;
const DEAD_AFTER = 7000;

/**
 * What becomes of the connection.
 * @typedef {object} Listener
 * @property {(message: any) => void} message
 * @property {(n: number, image: Blob) => void} picture
 * @property {(status: "open"|"lost", wait: number) => void} status `wait`: milliseconds until the next try
 */

export class Connection {
  /** @param {Listener} listener @param {string} [path] of the websocket; a lesson's, with the token of the page's address */
  constructor(listener, path = `/lesson${location.search}`) {
    this.listener = listener;
    this.path = path;
    this.wait = FIRST_WAIT;
    this.heard = 0;
    /** The page does not come back by itself, as another one teaches. */
    this.stays = false;
    /** The person wants the lesson, whoever has it. */
    this.wantsLesson = false;
    /** @type {WebSocket|null} */
    this.socket = null;
    this.timer = 0;
    /** Milliseconds of the last ping's way to the server and back. */
    this.roundTrip = NaN;
    setInterval(() => this.watch(), PING_EVERY);
    addEventListener("online", () => this.soon());
    document.addEventListener("visibilitychange", () => !document.hidden && this.soon());
  }

  get isOpen() {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  open() {
    clearTimeout(this.timer);
    this.stays = false;
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    // A token, where the server wants one, is in the path or in a cookie.
    const socket = new WebSocket(`${scheme}://${location.host}${this.path}`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.heard = performance.now();
    socket.onmessage = ({ data }) => this.socket === socket && this.receive(data);
    socket.onclose = () => this.socket === socket && this.closed();
  }

  /** @param {string|ArrayBuffer} data */
  receive(data) {
    this.heard = performance.now();
    if (typeof data !== "string") {
      if (data.byteLength <= 4) return;
      const image = new Blob([new Uint8Array(data, 4)], { type: "image/webp" });
      this.listener.picture(new DataView(data).getUint32(0, true), image);
      return;
    }
    const message = JSON.parse(data);
    switch (message.type) {
      case "hello":
        this.wait = FIRST_WAIT;
        if (message.taken && this.wantsLesson) this.send("take");
        this.wantsLesson = false;
        this.listener.status("open", 0);
        break;
      case "pong":
        this.roundTrip = performance.now() - message.at;
        break;
      case "gone":
        this.stays = /took over/i.test(message.reason);
    }
    this.listener.message(message);
  }

  closed() {
    this.socket = null;
    if (this.stays) return;
    this.listener.status("lost", this.wait);
    this.timer = setTimeout(() => this.open(), this.wait);
    this.wait = Math.min(LONGEST_WAIT, this.wait * 1.7);
  }

  /** Tries at once what would be tried later: the machine woke up, or the network is back. */
  soon() {
    if (this.socket === null && !this.stays) this.open();
  }

  /** A connection that says nothing for long is dead, though the browser does not know it: a laptop that slept. */
  watch() {
    if (!this.isOpen) return;
    if (performance.now() - this.heard > DEAD_AFTER) {
      const silent = this.socket;
      this.closed();
      silent?.close();
    } else {
      this.send("ping", { at: performance.now() });
    }
  }

  /** Asks for the lesson, where another page has it. */
  take() {
    if (this.isOpen) {
      this.send("take");
    } else {
      this.wantsLesson = true;
      this.open();
    }
  }

  /** @param {string} type @param {object} [content] @returns {boolean} whether it went out */
  send(type, content = {}) {
    if (!this.isOpen) return false;
    this.socket?.send(JSON.stringify({ type, ...content }));
    return true;
  }
}
