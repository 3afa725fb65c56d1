// Search in a site that is opened from a disk, where browsers start no worker: the worker's script runs in a hidden frame instead.
// Messages go both ways as with a Worker. The plugin `offline` would load such a script from the network.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      frame.srcdoc =
        '<script>postMessage = data => parent.postMessage(data, "*");</script>' +
        `<script src="${new URL(url, location)}"></script>`;
      this.frame = frame;
      this.loaded = new Promise(done => frame.addEventListener("load", done, { once: true }));
      window.addEventListener("message", event => {
        if (event.source === frame.contentWindow) this.dispatchEvent(new MessageEvent("message", { data: event.data }));
      });
      document.documentElement.append(frame);
    }

    postMessage(data) {
      this.loaded.then(() => window.postMessage.call(this.frame.contentWindow, data, "*"));  // the frame's own is replaced
    }

    terminate() {
      this.frame.remove();
    }
  };
}
