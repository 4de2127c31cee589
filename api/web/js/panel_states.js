// What a panel without its values says: it waits for them, there are none, they are old, or they could not be read.

import { by, element, say } from "./elements.js";
import { clockOf } from "./angles.js";

/** Panels, what they are read from, and what they say while there is nothing of it. */
const PANELS = {
  place: { of: ["state", "sky"], error: (o) => o.state && !o.state.connected && `No telescope connected${o.state.problem ? `: ${o.state.problem}` : "."}` },
  sky: { of: ["sky", "limits"] },
  bullseye: { of: ["jobs"], empty: (o) => !o.jobs.some((one) => one.attempts?.length), words: "No centering yet: order one, and each try is drawn here." },
  frame: { of: ["frame"], empty: (o) => !o.frame, words: "No look since the service was started." },
  strip: { of: ["tonight"], empty: (o) => o.tonight && !o.tonight.looks.length && !o.tonight.acts.length, words: "Nothing was done in this night yet." },
  attempts: { of: ["jobs"], empty: (o) => !o.jobs.some((one) => one.attempts?.length || one.result || one.problem), words: "No attempts yet." },
  drift: { of: ["offsets"], empty: (o) => !o.offsets?.looks.length, words: "No solved look in the last 14 hours." },
  residuals: { of: ["offsets", "frame"], empty: (o) => !o.offsets?.looks.length && !o.frame?.solved, words: "No solved look yet." },
  journal: { of: ["journal"] },
  doctors: { of: ["health"] },
  control: { of: ["lease"] },
  "next-panel": { of: ["state"], empty: () => !by("target-moves").textContent && !by("target-next").childElementCount,
    words: "What happens to a target in the next hours, once one is typed: limits, meridian, setting, the Sun." },
};

/** The state of a panel: [state, words]. `heard` knows what was read, `faults` why something wasn't. */
export function panelState(one, observatory, heard, faults) {
  if (observatory.lostSince !== null) return ["stale", `As of ${clockOf(observatory.lostUtc)} UTC: no connection.`];
  const fault = one.of.map((what) => faults.get(what)).find(Boolean);
  if (fault) return ["error", `Could not be read: ${fault.message}`];
  if (!one.of.every((what) => heard.has(what))) return ["loading", "Loading …"];
  const wrong = one.error?.(observatory);
  if (wrong) return ["error", wrong];
  if (one.empty?.(observatory)) return ["empty", one.words];
  return ["ready", ""];
}

export function showPanelStates(observatory) {
  const { heard, faults } = observatory;
  const notes = Object.fromEntries(Object.keys(PANELS).map((id) => {
    const note = element("p", { class: "state", hidden: true });
    by(id).append(note);
    return [id, note];
  }));
  function show() {
    for (const [id, one] of Object.entries(PANELS)) {
      const [state, words] = panelState(one, observatory, heard, faults), note = notes[id];
      by(id).dataset.state = note.dataset.state = state;
      note.hidden = state === "ready";
      say(note, words);
    }
  }
  for (const topic of ["heard", "link", "telescope", "state", "jobs", "frame", "offsets", "tonight", "health", "lease", "target", "sky"]) observatory.on(topic, show);
  show();
}
