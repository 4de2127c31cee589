// Targets that move among the stars: pasted elements, what comes next, following them; and what the sky says of that.

import { ask, NoConnection, Refused } from "./calls.js";
import { by, element, fill, say } from "./elements.js";
import { clockOf, degrees, span } from "./angles.js";

const TYPING_MS = 500;
const FRESH_MS = 60_000;
const HOURS = 12, HOURS_OF_SATELLITE = 1.5; // its way is looked at in steps of a second
const MOST_EVENTS = 5;
const WORDS = {
  rises: "rises", sets: "sets", meridian: "meridian", "lower-meridian": "lower meridian", "sun-near": "too near the Sun",
  "sun-far": "clear of the Sun", limit: "reaches limit", "within-limit": "inside limit",
};

/** What was pasted, as a target: two lines of a satellite, or elements of a comet or minor planet. Null: nothing. */
export function readElements(text) {
  const lines = text.split(/\r?\n/).map((one) => one.trimEnd()).filter((one) => one.trim());
  if (!lines.length) return null;
  const first = lines.findIndex((one) => /^1 [ 0-9A-Z]{5}/.test(one));
  if (first >= 0 && /^2 [ 0-9A-Z]{5}/.test(lines[first + 1] ?? "")) return { kind: "satellite", elements: lines.join("\n") };
  return { kind: "elements", elements: lines.join("\n") };
}

/** Rates as people read them: ″/s where it is fast, ″/min where it is slow. */
export function rateWords(arcsecS) {
  if (arcsecS === null || arcsecS === undefined) return "unknown";
  const size = Math.abs(arcsecS);
  if (size >= 3600) return `${(arcsecS / 3600).toFixed(2)}°/s`;
  if (size >= 1) return `${arcsecS.toFixed(2)}″/s`;
  return `${(arcsecS * 60).toFixed(size * 60 >= 10 ? 1 : 2)}″/min`;
}

export function showMoving(observatory, typed, give) {
  const box = by("elements"), list = by("target-next"), words = by("target-moves"), button = by("follow");
  let told = null, waiting = null, asked = "", told_ms = 0;

  const target = () => readElements(box.value) ?? typed();
  const key = () => JSON.stringify([observatory.id, target()]);

  function show() {
    const ready = Boolean(observatory.state?.connected) && observatory.lostSince === null;
    button.disabled = !ready || !told || !told.moves;
    button.hidden = !observatory.capabilities?.kinds.some((one) => one.kind === "follow");
    by("follow-row").style.visibility = button.hidden || !told?.moves ? "hidden" : ""; // its room is kept
    if (!told) {
      fill(list);
      return;
    }
    if (told.failed) {
      say(words, told.failed);
      words.className = "bad-text";
      fill(list);
      return;
    }
    words.className = "dim";
    const height = told.altitude_deg === null ? "" : `, altitude ${degrees(told.altitude_deg)}`;
    say(words, told.moves
      ? `${told.name} moves by ${rateWords(told.total_arcsec_s)}${height}${told.sigma_arcsec > 1 ? `; known to ${told.sigma_arcsec.toFixed(0)}″` : ""}.`
      : `${told.name} stands still among the stars${height}.`);
    const events = told.events.slice(0, MOST_EVENTS);
    fill(list, ...events.map((one) => element("li", { class: one.kind === "limit" || one.kind === "sun-near" ? "warn-text" : "" },
      element("time", { datetime: one.utc }, clockOf(one.utc).slice(0, 5)),
      element("span", {}, what(one)),
      element("span", { class: "num" }, one.altitude_deg === null ? "" : `${degrees(one.altitude_deg)} high`))),
    events.length ? null : element("li", { class: "dim" }, `nothing within ${span((Date.parse(told.until_utc) - Date.parse(told.utc)) / 1000)}`));
  }

  function what(event) {
    const limit = event.limit && event.kind.includes("limit") ? `: ${event.limit}` : "";
    // what it is outside of already is told at the beginning
    const already = event.kind === "limit" && Math.abs(Date.parse(event.utc) - Date.parse(told.utc)) < 1000;
    return already ? `now outside limit${limit}` : `${WORDS[event.kind] ?? event.kind}${limit}`;
  }

  async function read() {
    const wanted = target(), mine = key();
    if (!wanted || !observatory.id) return;
    asked = mine;
    try {
      const found = await ask(observatory.path("forecast"), { target: wanted, hours: wanted.kind === "satellite" ? HOURS_OF_SATELLITE : HOURS });
      if (key() !== mine) return;
      told = found;
    } catch (error) {
      if (key() !== mine) return;
      told = error instanceof Refused ? { failed: error.message, events: [], moves: false } : told;
      if (error instanceof NoConnection) asked = "";
    }
    told_ms = Date.now();
    show();
  }

  function soon() {
    clearTimeout(waiting);
    if (key() === asked && Date.now() - told_ms < FRESH_MS) return;
    if (key() !== asked) {
      told = null;
      say(words, "");
      show();
    }
    if (target()) waiting = setTimeout(read, TYPING_MS);
    else asked = "";
  }

  box.addEventListener("input", soon);
  observatory.on("target", soon);
  observatory.on("telescope", soon);
  observatory.on("sky", () => {
    if (told && !document.hidden && Date.now() - told_ms > FRESH_MS) soon();
  });
  for (const topic of ["state", "link", "capabilities"]) observatory.on(topic, show);
  button.addEventListener("click", () => {
    const wanted = target();
    if (wanted) give({ kind: "follow", target: wanted, duration_s: Number(by("follow-for").value) }, `follow ${told?.name ?? ""}`.trim());
  });
  by("elements-clear").addEventListener("click", () => {
    box.value = "";
    soon();
  });
  show();
}

/** What is followed, at which rates, until when, and what the sky says of it: lines of the panel of the position. */
export function showFollowing(observatory) {
  const panel = by("following"), lines = by("following-lines");
  function show() {
    const { state } = observatory;
    const rates = state?.rates, following = state?.following, axes = state?.axes_moved ?? [];
    panel.hidden = !rates && !following && !axes.length && !state?.following_problem;
    if (panel.hidden) return;
    const row = (name, value, tone = "") => [element("dt", {}, name), element("dd", { class: `live ${tone ? `${tone}-text` : ""}` }, value)];
    fill(lines,
      ...(following ? row("Follows", `${following.name ?? "a target"}${following.until_utc ? ` until ${clockOf(following.until_utc)}` : ""}`) : []),
      ...(following ? row("The sky says", following.words || "nothing yet: no look has been solved", following.fault ? "bad" : following.words ? "good" : "dim") : []),
      ...(following?.seen_dec_arcsec_s !== null && following?.seen_dec_arcsec_s !== undefined
        ? row("Measured", `${rateWords(following.seen_ra_arcsec_s)} RA, ${rateWords(following.seen_dec_arcsec_s)} Dec`) : []),
      ...(rates ? row("Rates", `${rateWords(rates.ra_arcsec_s)} RA, ${rateWords(rates.dec_arcsec_s)} Dec`) : []),
      ...(rates ? row("until", `${clockOf(rates.ends_utc)} UTC`) : []),
      ...(following?.next_event ? row("Next", following.next_event) : []),
      ...axes.flatMap((one) => row(one.axis === "primary" ? "RA axis" : "Dec axis", `by hand at ${one.rate_deg_s.toPrecision(2)}°/s`, "warn")),
      ...(state.following_problem ? row("Trouble", state.following_problem, "bad") : []));
  }
  for (const topic of ["state", "telescope"]) observatory.on(topic, show);
  show();
}
