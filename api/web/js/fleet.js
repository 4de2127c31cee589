// Several telescopes at a glance: a lamp at each name, and the wall of tiles. Read every few seconds, in one question.

import { getIfNew, NoConnection } from "./calls.js";
import { by, element, fill, say } from "./elements.js";
import { degrees, dms, hms, small, span } from "./angles.js";
import { stateWords } from "./state_line.js";

const EVERY_MS = 4000, WALL_MS = 1500, HIDDEN_MS = 15_000;
const READ_OLD_S = 10, LOOK_OLD_S = 120;

/** What a telescope is on, and how well the last look saw it; `age_s`: of that look, told once it is old. */
export function onWords(on, age_s) {
  if (!on) return "no target";
  const name = on.name ?? "a target";
  const off = on.error_arcsec === null ? "" : ` · ${small(on.error_arcsec)} off${age_s !== null && age_s > LOOK_OLD_S ? `, ${span(age_s)} ago` : ""}`;
  return `${on.arrived ? "" : "to "}${name}${off}`;
}

export function showFleet(observatory) {
  const wall = by("wall"), opener = by("wall-open");
  let known = null, wake = () => {}, failed = null, names = "", tiled = "";
  const lamps = new Map();

  const open = () => document.body.classList.contains("wall");
  const several = () => observatory.telescopes.length > 1;

  async function read() {
    if (!several() && !observatory.wantsFleet) return;
    try {
      const found = await getIfNew("/v1/telescopes", known);
      failed = null;
      if (found !== known) {
        known = found;
        observatory.fleet = found.told;
        observatory.tell("fleet");
      } else observatory.tell("fleet");
    } catch (error) {
      failed = error;
      if (!(error instanceof NoConnection)) known = null;
      observatory.tell("fleet");
    }
  }

  function chooser() {
    document.body.classList.toggle("several", several());
    opener.hidden = !several();
    const now = observatory.telescopes.map((one) => one.id).join(" ");
    if (names !== now) {
      names = now;
      lamps.clear();
      fill(by("telescopes"), ...observatory.telescopes.map((one) => {
        const lamp = element("i", { class: "lamp", "aria-hidden": "true" });
        const button = element("button", { type: "button", "data-id": one.id, onclick: () => {
          observatory.choose(one.id);
          show(false);
        } }, several() ? lamp : null, element("span", {}, one.id));
        lamps.set(one.id, { lamp, button });
        return button;
      }));
    }
    for (const [id, { button }] of lamps) button.setAttribute("aria-pressed", String(id === observatory.id));
  }

  function tones() {
    const lost = observatory.lostSince !== null || failed !== null;
    for (const state of observatory.fleet) {
      const made = lamps.get(state.id);
      if (!made) continue;
      const { word, tone } = stateWords(state, null);
      made.lamp.dataset.tone = lost ? "none" : tone;
      made.button.title = lost ? "not known" : `${state.id}: ${word}`;
    }
    if (open()) tiles(lost);
  }

  function tiles(lost) {
    const now = observatory.fleet.map((one) => one.id).join(" ");
    if (!observatory.fleet.length) {
      fill(wall, element("p", { class: "dim" }, failed ? `Not read: ${failed.message}` : "Reading …"));
      tiled = "";
      return;
    }
    if (tiled !== now) {
      tiled = now;
      fill(wall, ...observatory.fleet.map((one) => element("button", { type: "button", class: "tile", "data-id": one.id, onclick: () => {
        observatory.choose(one.id);
        show(false);
      } },
        element("i", { class: "lamp", "aria-hidden": "true" }), element("b", {}, one.id), element("span", { class: "word" }),
        element("p", { class: "words on" }), element("p", { class: "words num place" }), element("p", { class: "words num sky dim" }), element("p", { class: "words say dim" }))));
    }
    for (const tile of wall.querySelectorAll(".tile")) {
      const state = observatory.fleet.find((one) => one.id === tile.dataset.id);
      const { word, tone, detail } = stateWords(state, null);
      const age = observatory.ageOf(state.read_utc), old = lost || (age !== null && age > READ_OLD_S);
      tile.dataset.tone = lost ? "none" : tone;
      tile.toggleAttribute("data-old", old);
      tile.querySelector(".lamp").dataset.tone = lost ? "none" : tone;
      const put = (selector, text) => say(tile.querySelector(selector), text);
      put(".word", lost ? "not known" : word);
      put(".on", onWords(state.on, observatory.ageOf(state.on?.error_utc ?? null)));
      put(".place", state.icrs ? `${hms(state.icrs.ra_deg, 0)} ${dms(state.icrs.dec_deg)}` : "position not known");
      put(".sky", [state.altitude_deg === null ? "" : `${degrees(state.altitude_deg)} high`,
        state.next_limit ? `${state.next_limit.limit} limit in ${span(state.next_limit.after_s)}` : ""].filter(Boolean).join(" · "));
      put(".say", old && !lost ? `read ${age === null ? "never" : `${span(age)} ago`}` : detail || (state.still_since_utc ? "" : " "));
      tile.setAttribute("aria-label", `Show ${state.id}: ${lost ? "not known" : word}${detail ? `, ${detail}` : ""}`);
    }
  }

  function show(yes) {
    document.body.classList.toggle("wall", yes);
    wall.hidden = !yes;
    opener.setAttribute("aria-pressed", String(yes));
    if (yes) {
      tones();
      wake();
    }
    window.dispatchEvent(new Event("resize"));
  }

  opener.addEventListener("click", () => show(!open()));
  observatory.on("telescopes", () => {
    chooser();
    wake();
  });
  observatory.on("telescope", chooser);
  for (const topic of ["fleet", "link"]) observatory.on(topic, tones);
  (async () => {
    for (;;) {
      if (observatory.telescopes.length) await read();
      await new Promise((done) => {
        wake = done;
        setTimeout(done, document.hidden ? HIDDEN_MS : open() ? WALL_MS : EVERY_MS);
      });
    }
  })();
}
