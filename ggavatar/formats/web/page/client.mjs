// The page's side of the worker. One request is under way at a time; of those that wait, the newest wins.

export class Client {
  constructor(source) {
    const address = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
    this.worker = new Worker(address);
    this.waiting = null;
    this.busy = false;
  }

  // Opens the file; resolves to what the worker says of it.
  open(buffer) {
    return new Promise((resolve, reject) => {
      this.worker.onmessage = ({ data }) => (data.error ? reject(new Error(data.error)) : resolve(data));
      this.worker.onerror = (event) => reject(new Error(`The page's worker does not start (${event.message}).`));
      this.worker.postMessage({ buffer }, [buffer]);
    });
  }

  // Calls `onAnswer` with every answer and the view that it was asked for, and `onError` with a sentence.
  listen(onAnswer, onError) {
    this.worker.onerror = (event) => onError(`The page's worker stopped (${event.message}). Load the page again.`);
    this.worker.onmessage = ({ data }) => {
      const { view } = this.current;
      this.busy = false;
      if (data.error) onError(data.error);
      else onAnswer(data, view);
      this.send();
    };
  }

  // A drive of null asks for a new order only; `view.numbers` is the view, whatever else it holds comes back.
  ask(drive, view) {
    const kept = this.waiting && this.waiting.drive;
    this.waiting = { drive: drive || kept || null, view };
    this.send();
  }

  get idle() {
    return !this.busy && !this.waiting;
  }

  send() {
    if (this.busy || !this.waiting) return;
    Object.assign(this, { busy: true, current: this.waiting, waiting: null });
    const { drive, view } = this.current;
    this.worker.postMessage({ drive, view: view.numbers });
  }
}
