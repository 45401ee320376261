// A page that was opened from a disk may start no Worker, and the search of the site wants one. There a hidden frame
// stands for it: it runs the same script, and messages go to and fro as events. (The offline plugin knows this file by its
// name, and else would load one from the net.)
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(address) {
      super();
      const here = new URL(address, location);
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.documentElement.append(frame);
      const inside = frame.contentWindow;
      const run = (source) => new Promise((done, failed) => {
        const script = inside.document.createElement("script");
        script.src = new URL(source, here);
        script.onload = done;
        script.onerror = failed;
        inside.document.documentElement.append(script);
      });
      inside.importScripts = (...sources) => sources.reduce((before, each) => before.then(() => run(each)), Promise.resolve());
      inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      this.frame = frame;
      this.ready = run(here);
    }

    postMessage(data) {
      const inside = this.frame.contentWindow;
      this.ready.then(() => inside.dispatchEvent(new inside.MessageEvent("message", { data })));
    }

    terminate() {
      this.frame.remove();
    }
  };
}
