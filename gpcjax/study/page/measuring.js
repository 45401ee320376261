// What a page can tell of its machine: size, animation frames a second, the way to the server and back.

const FRAMES_FOR = 1500;
const AT_MOST = 5000;
const PINGS = 9;
const PING_APART = 80;

const wait = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));

/** Animation frames a second; 0 where there are none, as in a page that is not seen. @returns {Promise<number>} */
function frameRate() {
  return new Promise((done) => {
    let first = 0;
    let count = 0;
    const late = setTimeout(() => done(0), AT_MOST);
    const frame = (now) => {
      if (first === 0) first = now;
      else count += 1;
      if (now - first < FRAMES_FOR) return requestAnimationFrame(frame);
      clearTimeout(late);
      done((1000 * count) / (now - first));
    };
    requestAnimationFrame(frame);
  });
}

export class Measuring {
  /** @param {import("/page/connection.js").Connection} connection */
  constructor(connection) {
    this.connection = connection;
    /** Who waits for which answer, by the time of its ping. @type {Map<number, () => void>} */
    this.asked = new Map();
  }

  /** An answer has come. @param {number} at of its ping */
  pong(at) {
    this.asked.get(at)?.();
    this.asked.delete(at);
  }

  /** Milliseconds to the server and back, the median of several. */
  async roundTrip() {
    const trips = [];
    for (let k = 0; k < PINGS; k++) {
      const at = performance.now();
      const answer = new Promise((done) => this.asked.set(at, done));
      if (!this.connection.send("ping", { at })) break;
      await Promise.race([answer, wait(AT_MOST)]);
      trips.push(performance.now() - at);
      await wait(PING_APART);
    }
    trips.sort((a, b) => a - b);
    return trips.length ? trips[Math.floor(trips.length / 2)] : AT_MOST;
  }

  /** All of it. */
  async all() {
    // One after the other: each is measured without the other's work.
    const frames = await frameRate();
    const trip = await this.roundTrip();
    const round = (value) => Math.round(value * 10) / 10;
    return { width: innerWidth, height: innerHeight, frame_rate: round(frames), round_trip: round(trip) };
  }
}
