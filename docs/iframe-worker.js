/* The search of a page that was opened from a folder. It asks for a worker, and browsers start none from a file; here its
   script runs in a hidden frame. */
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.waiting = [];
      const frame = document.createElement("iframe");
      frame.hidden = true;
      frame.srcdoc = "<!doctype html>";
      frame.addEventListener("load", () => {
        const inside = frame.contentWindow, script = inside.document.createElement("script");
        inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
        script.src = url;
        script.addEventListener("load", () => {
          this.postMessage = (data) => inside.dispatchEvent(new MessageEvent("message", { data }));
          this.waiting.forEach(this.postMessage);
        });
        inside.document.head.append(script);
      }, { once: true });
      document.body.append(frame);
    }

    postMessage(data) {
      this.waiting.push(data);
    }
  };
}
