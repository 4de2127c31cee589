// The event stream, read by fetch: EventSource can't send a key. Resumes after the last event it has heard.

import { headersWithKey } from "./calls.js";

const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 15_000;
const SILENT_MS = 40_000; // the service says something every 15 s

/** Follow events for ever; `heard(kind, data)` for each, `link(up)` when the stream comes and goes. */
export function follow(path, heard, link) {
  let lastId = null, waitMs = FIRST_WAIT_MS, over = false, abort = null, wake = null, paused = false;

  async function once() {
    abort = new AbortController();
    const headers = headersWithKey({ Accept: "text/event-stream" });
    if (lastId !== null) headers["Last-Event-ID"] = lastId;
    const response = await fetch(path, { headers, cache: "no-store", signal: abort.signal });
    if (!response.ok || !response.body) throw new Error(`HTTP ${response.status}`);
    link(true);
    waitMs = FIRST_WAIT_MS;
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    let pending = "";
    for (;;) {
      const watchdog = setTimeout(() => abort.abort(), SILENT_MS);
      const { value, done } = await reader.read().finally(() => clearTimeout(watchdog));
      if (done) return;
      pending += value;
      const messages = pending.split(/\r?\n\r?\n/);
      pending = messages.pop();
      for (const message of messages) take(message);
    }
  }

  function take(message) {
    const fields = { event: "message", data: [] };
    for (const line of message.split(/\r?\n/)) {
      const at = line.indexOf(":");
      if (at === 0) continue;
      const name = at < 0 ? line : line.slice(0, at), value = at < 0 ? "" : line.slice(at + 1).replace(/^ /, "");
      if (name === "data") fields.data.push(value);
      else fields[name] = value;
    }
    if (fields.id !== undefined) lastId = fields.id;
    if (!fields.data.length) return;
    let data;
    try {
      data = JSON.parse(fields.data.join("\n"));
    } catch {
      return;
    }
    heard(fields.event, data);
  }

  (async () => {
    while (!over) {
      try {
        if (!paused) await once();
      } catch {
        // whatever cut it, it is begun again
      }
      link(false);
      await new Promise((done) => {
        wake = done;
        setTimeout(done, waitMs * (0.7 + 0.6 * Math.random()));
      });
      waitMs = Math.min(LONGEST_WAIT_MS, 2 * waitMs);
    }
  })();
  const again = () => {
    waitMs = FIRST_WAIT_MS;
    abort?.abort();
    wake?.();
  };
  return {
    /** Begin again now, with the key of now. */
    again,
    /** Hold no connection until it is wanted again. */
    pause: (yes) => {
      if (paused === yes) return;
      paused = yes;
      again();
    },
    /** Let go of the connection for a moment. */
    drop: () => abort?.abort(),
    end: () => { over = true; again(); },
  };
}
