// STOP: first of all, from the button or by Escape twice; asked again until the service has answered.

import { dropOrders, headersWithKey } from "./calls.js";
import { by, element, fill } from "./elements.js";
import { clockOf } from "./angles.js";
import { restWords } from "./headline.js";
import { unask } from "./question.js";

const TWICE_MS = 1500;
const TRIES = 20;
const PAUSE_MS = 700;
const WAIT_MS = 5000;
const ALL = "/v1/stop";

export function takeStop(observatory) {
  const button = by("stop"), banner = by("stop-told");
  let armed = 0;
  /** The newest stop of each path, and what is told of it: one telescope's never takes another's away. */
  const stops = new Map();

  function show() {
    const all = [...stops.values()];
    const tone = ["bad", "warn"].find((one) => all.some((stop) => stop.tone === one)) ?? "good";
    banner.className = `banner ${tone}`;
    banner.hidden = false;
    fill(banner, ...all.map((stop) => element("span", { class: `${stop.tone}-text` }, stop.words)),
      element("button", { type: "button", onclick: seen }, "Seen"));
  }

  function seen() {
    banner.hidden = true;
    for (const [path, stop] of stops) if (stop.over) stops.delete(path);
  }

  /** Send until it is answered. Each press begins anew, and never waits for the one before. */
  async function send(path, who) {
    // one for all is one for each; and what was told of the last press is old
    for (const [other, stop] of stops) if (path === ALL || stop.over) stops.delete(other);
    const mine = { tone: "warn", words: "", over: false };
    stops.delete(path);
    stops.set(path, mine);
    try {
      await sent(path, who, () => stops.get(path) === mine, (tone, words) => {
        Object.assign(mine, { tone, words });
        show();
      });
    } finally {
      mine.over = true;
    }
  }

  async function sent(path, who, counts, told) {
    // an order that waits for its answer must not come behind the stop, nor a question that was open
    dropOrders(path === ALL ? null : observatory.id);
    observatory.tell("stopping"); // no key moves anything from here on
    unask();
    const clock = () => clockOf(observatory.now() ?? Date.now()); // the service's, once it was heard
    const began = clock();
    let silent = false;
    const missed = () => (silent ? "NO ANSWER, not certain that it stopped" : "NOT SENT, no connection");
    told("warn", `STOP ${who}: sending …`);
    for (let attempt = 1; attempt <= TRIES; attempt++) {
      if (!counts()) return;
      try {
        const response = await fetch(path, {
          method: "POST", headers: headersWithKey({ Accept: "application/json" }), cache: "no-store",
          signal: AbortSignal.timeout(WAIT_MS), keepalive: true,
        });
        const answer = await response.json().catch(() => ({}));
        if (!counts()) return;
        if (response.ok && answer.stopped === false) {
          const missed = (answer.telescopes ?? []).filter((one) => !one.stopped).map((one) => `${one.telescope}: ${one.problem ?? "not told"}`);
          told("bad", `STOP ${who}: NOT ALL were told. ${missed.join("; ")}. Look at them; use their own hand controls.`);
          return;
        }
        if (response.ok && answer.stopped === null) {
          // a mount that takes long: the stop is on its way, and is asked for until it is known
          const late = (answer.telescopes ?? [{ telescope: who, stopped: null }]).filter((one) => one.stopped === null);
          told("warn", `STOP ${who}: NOT KNOWN YET whether ${late.map((one) => one.telescope).join(", ")} was told, since ${began} UTC; trying again (${attempt}). Look at it; use its own hand control.`);
          await new Promise((done) => setTimeout(done, PAUSE_MS));
          continue;
        }
        if (response.ok) {
          const at = observatory.now() ?? Date.now();
          const ids = path === ALL ? observatory.telescopes.map((one) => one.id) : [who];
          observatory.soon("jobs", 0);
          observatory.wantsFleet = true;
          settle(ids, at, counts, (tone, words) => told(tone, `STOP ${who}: told the mount${ids.length > 1 ? "s" : ""} at ${began} UTC${words}`));
          return;
        }
        const words = [answer.detail, answer.advice].filter(Boolean).join(": ") || `HTTP ${response.status}`;
        told("bad", `STOP ${who}: NOT CERTAIN that it stopped. ${words}. Look at the telescope; use its own hand control.`);
        if (response.status < 500 && response.status !== 429) return;
      } catch (error) {
        if (!counts()) return;
        observatory.quiet(); // a browser has few connections to one place: the stream gives way
        silent ||= error.name === "TimeoutError"; // it may have been heard
        told("bad", `STOP ${who}: ${missed()} since ${began} UTC; trying again (${attempt}). Use the mount's own hand control.`);
      }
      await new Promise((done) => setTimeout(done, PAUSE_MS));
    }
    if (counts()) told("bad", `STOP ${who}: ${missed()}. ${TRIES} tries since ${began} UTC came to nothing. Use the mount's own hand control.`);
  }

  /** Follow what was told until it is seen at rest, by readings that came after the stop. */
  function settle(ids, at, counts, told) {
    let over = false;
    const look = () => {
      if (over || !counts()) return;
      const words = ids.map((id) => {
        const state = id === observatory.id ? observatory.state : observatory.fleet.find((one) => one.id === id);
        const fresh = state?.read_utc && Date.parse(state.read_utc) > at;
        return fresh ? restWords(state) ?? "stopping …" : state?.connected === false ? "not connected" : "stopping …";
      });
      over = !words.includes("stopping …");
      told(over ? "good" : "warn", ids.length > 1 ? `: ${ids.map((id, i) => `${id} ${words[i]}`).join("; ")}.` : `; ${words[0]}${over ? "." : ""}`);
      if (over) observatory.wantsFleet = false;
    };
    for (const topic of ["state", "fleet"]) observatory.on(topic, look);
    look();
  }

  const stop = () => {
    disarm();
    if (observatory.id) send(observatory.path("stop"), observatory.id);
    else send(ALL, "all");
  };
  const disarm = () => {
    armed = 0;
    button.classList.remove("armed");
  };
  button.addEventListener("click", stop);
  by("stop-all").addEventListener("click", () => send(ALL, "all"));
  // in the capturing phase: no field, list or question keeps the keys from it
  document.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || event.repeat) return;
    if (performance.now() - armed < TWICE_MS) {
      stop();
      return;
    }
    armed = performance.now();
    button.classList.add("armed");
    setTimeout(() => {
      if (performance.now() - armed >= TWICE_MS - 50) disarm();
    }, TWICE_MS);
  }, { capture: true });
  observatory.on("telescopes", () => {
    by("stop-all").hidden = observatory.telescopes.length < 2;
  });
  observatory.on("telescope", () => {
    button.setAttribute("aria-label", `STOP ${observatory.id}`);
  });
}
