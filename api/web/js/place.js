// Where the telescope points, in every way one asks for it at night. What isn't known is a dash.

import { by, element, fill, say } from "./elements.js";
import { degrees, dms, hms, hourAngle, span } from "./angles.js";

const SIDES = { east: "east (looks west)", west: "west (looks east)" };
const OLD_S = 5;

export function showPlace(observatory) {
  const cells = {};
  function row(name, words, style = "of-mount") {
    cells[name] = element("dd", { class: `live num ${style}` }, "–");
    return [element("dt", {}, words), cells[name]];
  }
  fill(
    by("place-list"),
    ...row("ra", "RA ICRS", "of-mount big"), ...row("dec", "Dec ICRS", "of-mount big"), element("div", { class: "rule" }),
    ...row("raDate", "RA of date"), ...row("decDate", "Dec of date"), element("div", { class: "rule" }),
    ...row("alt", "Altitude"), ...row("az", "Azimuth"), ...row("ha", "Hour angle"), ...row("lst", "Sidereal time", "of-sky"),
    element("div", { class: "rule" }),
    ...row("limit", "Time to limit"), ...row("pier", "Pier side"), ...row("tracking", "Tracking"), ...row("link", "Link", "of-line"),
    ...row("sun", "Sun", "of-sky"),
  );
  function set(name, text, tone = "") {
    const cell = cells[name];
    say(cell, text ?? "–");
    cell.classList.toggle("unknown", text === null || text === undefined);
    cell.classList.toggle("warn-text", tone === "warn");
    cell.classList.toggle("bad-text", tone === "bad");
  }

  function showState() {
    const state = observatory.state;
    const icrs = state?.icrs;
    set("ra", hms(icrs?.ra_deg));
    set("dec", dms(icrs?.dec_deg));
    const known = (value, yes, no) => (value === null || value === undefined ? null : value ? yes : no);
    set("tracking", state?.parked ? "parked" : known(state?.tracking, "on", "off"));
    // only a German mount has two sides to tell apart
    set("pier", observatory.can && observatory.can.mounting !== "german" ? null : state?.pier_side ? (SIDES[state.pier_side] ?? state.pier_side) : null);
    const link = state ? (state.link ?? (state.connected ? "up" : "lost")) : null;
    set("link", link, link === "up" || link === null ? "" : "bad");
    const warnings = state ? [...(state.warnings ?? [])] : [];
    if (state?.problem) warnings.unshift(state.problem);
    if (state?.trusted === false) warnings.unshift("The mount's position is not trusted: nothing slews before a first light, a recovery or a home.");
    by("contradiction").hidden = !state?.contradiction;
    fill(by("warnings"), ...warnings.map((one) => element("li", {}, one)));
  }

  function showSky() {
    const sky = observatory.sky, reading = observatory.state?.reading;
    set("raDate", hms(sky?.of_date?.ra_deg));
    set("decDate", dms(sky?.of_date?.dec_deg));
    set("alt", dms(sky?.altitude_deg));
    set("az", dms(sky?.azimuth_deg, 0, ""));
    set("ha", hourAngle(sky?.hour_angle_deg));
    set("lst", hms(sky?.sidereal_deg, 0));
    const ahead = sky?.ahead;
    const { state } = observatory;
    // where tracking would lead is no answer while it doesn't track
    if (!sky?.icrs) set("limit", null);
    else if (state?.parked || state?.tracking === false) set("limit", "not tracking");
    else if (!ahead) set("limit", "none in 12 h");
    else set("limit", `${span(ahead.after_s)}, ${ahead.limit}`, ahead.after_s < 300 ? "bad" : ahead.after_s < 1800 ? "warn" : "");
    set("sun", sky ? `${degrees(sky.sun.altitude_deg)} high` : null);
    const speed = observatory.health?.virtual?.speed ?? 1;
    const age = reading?.utc && sky ? Math.max(0, (new Date(sky.utc) - new Date(reading.utc)) / 1000 / speed) : null;
    say(by("place-age"), age === null ? "" : age < 2 ? "now" : `read ${span(age)} ago`);
    by("place-age").classList.toggle("bad-text", age !== null && age > OLD_S);
    by("place").classList.toggle("stale", age !== null && age > OLD_S);
  }
  observatory.on("state", showState);
  observatory.on("sky", showSky);
  showState();
  showSky();
}
