// The state in one line: a word, a lamp, what goes on; and the banner that says when nothing is known any more.

import { by, say } from "./elements.js";
import { lease as kept } from "./calls.js";
import { clockOf, span } from "./angles.js";
import { restWords } from "./headline.js";

// no longer than "No connection": the head has room for that, on a phone too
const DOING = {
  center: "Centering", slew: "Slewing", look: "Looking", sync: "Syncing", "sync-to": "Syncing", recover: "Recovering",
  "first-light": "First light",
  offset: "Nudging", "set-park": "Park set", hold: "Holding", dither: "Dithering", rotate: "Rotating", mosaic: "Mosaic", "spiral-search": "Searching", "forget-rates": "Forgetting", flip: "Flipping", park: "Parking", unpark: "Unparking", home: "Homing", solve: "Solving",
  follow: "Following", "offset-rates": "Rates set", "move-axis": "By hand",
  series: "Looking again", "model-run": "Model run", tracking: "Tracking set", trust: "Trusting", "set-site-time": "Setting site", "accept-site-time": "Accepting", guide: "Guiding",
};

/** The word for what a telescope does now, its tone, and what else is to be said. */
export function stateWords(state, job, lease = null) {
  if (!state) return { word: "unknown", tone: "none", detail: "" };
  if (!state.connected) return { word: "Disconnected", tone: "bad", detail: state.problem ?? "" };
  const running = state.job_id && job?.id === state.job_id ? job : null;
  const detail = [];
  if (running) {
    if (running.phase && running.phase !== "ended") detail.push(running.phase);
    if (running.attempts?.length) detail.push(`try ${running.attempts.length}`);
  }
  if (state.trusted === false) detail.push("position not trusted");
  if (state.problem) detail.push(state.problem);
  if (lease) detail.push(`held by ${lease.holder}`);
  const rest = restWords(state);
  if (!state.job_id && rest && state.tracking !== true) detail.push(rest);
  const say = (word, tone) => ({ word, tone, detail: detail.join(" · ") });
  if (state.job_id) return say(DOING[running?.kind ?? state.job_kind] ?? (state.slewing ? "Slewing" : "Busy"), "busy");
  if (state.slewing) return say("Slewing", "busy");
  if (state.trusted === false) return say("Not trusted", "bad");
  if (state.problem) return say("Trouble", "bad");
  if (state.parked) return say("Parked", "none");
  if (state.rates) return say("At set rates", "good");
  if (state.tracking === true) return say("Tracking", "good");
  if (state.tracking === false) return say("At rest", "none");
  return say("Ready", "good");
}

export function showStateLine(observatory) {
  function show() {
    const { lease } = observatory;
    const other = lease?.held && !kept.get(observatory.id) ? lease : null;
    // a word of a while ago, in the head or in the tab's name, would be read as of now
    const { word, tone, detail } = observatory.lostSince !== null
      ? { word: "No connection", tone: "bad", detail: `since ${clockOf(observatory.lostUtc)} UTC` }
      : stateWords(observatory.state, observatory.job, other);
    say(by("state-word"), word);
    say(by("state-detail"), detail);
    by("state-detail").title = detail;
    document.body.dataset.tone = tone;
    document.title = observatory.id ? `${word} · ${observatory.id}` : "mountnav";
  }
  observatory.on("state", show);
  observatory.on("job", show);
  observatory.on("lease", show);
  observatory.on("sky", () => {
    const sky = observatory.sky;
    say(by("clock-time"), sky ? clockOf(sky.utc) : "--:--:--");
  });
  observatory.on("link", () => {
    const since = observatory.lostSince;
    document.body.classList.toggle("lost", since !== null);
    by("lost").hidden = since === null;
    show();
    if (since === null) return;
    say(by("place-age"), "old");
    const ago = span((Date.now() - since) / 1000);
    say(by("lost"), `Connection lost since ${clockOf(observatory.lostUtc)} UTC, ${ago} ago. Everything below is old; trying again.`);
  });
  observatory.on("health", () => {
    const { health } = observatory;
    const virtual = health?.virtual;
    by("virtual").hidden = !virtual;
    if (virtual) say(by("virtual"), `Virtual observatory: fake mount, drawn sky, time runs ${virtual.speed}×`);
    if (health) say(by("version"), `mountnav ${health.version}`);
  });
  show();
}
