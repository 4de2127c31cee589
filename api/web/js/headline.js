// The headline: what the telescope is on, how well, and how long yet. What isn't known isn't said; what is old says its age.

import { by, element, fill, say } from "./elements.js";
import { clockOf, degrees, hours, minuteOf, small } from "./angles.js";

const OLD_S = 120; // a look's figures are told with their age from here on
const READ_OLD_S = 5; // a reading older than this is not of now

/** The parts of the headline: {target, parts: [{text, old}]}; `now` and all instants by the service's clock. */
export function headlineParts(sky, state) {
  if (!sky?.headline || !state?.connected) return { target: null, parts: [] };
  const { headline } = sky, now = Date.parse(sky.utc), parts = [];
  const age = (utc) => (now - Date.parse(utc)) / 1000;
  const aged = (text, utc) => (age(utc) > OLD_S ? { text: `${text}, ${hours(age(utc))} ago`, old: true } : { text });
  if (headline.error_arcsec !== null) parts.push(aged(`${small(headline.error_arcsec)} off`, headline.error_utc));
  else if (headline.target && headline.arrived) parts.push({ text: "not seen since it came", old: true });
  if (headline.fwhm_arcsec !== null) parts.push(aged(`FWHM ${small(headline.fwhm_arcsec)}`, headline.fwhm_utc));
  if (sky.altitude_deg !== null) parts.push({ text: `${degrees(sky.altitude_deg)} high` });
  const meridian = headline.meridian_s;
  if (meridian !== null) {
    parts.push({ text: meridian >= 30 ? `${hours(meridian)} to meridian` : meridian > -30 ? "on the meridian" : `${hours(-meridian)} past meridian` });
  }
  const next = nextOfSun(headline.times, now);
  if (next) parts.push({ text: `${next.word} ${minuteOf(next.utc)}` });
  return { target: headline.target ? (headline.arrived === false ? `to ${headline.target}` : headline.target) : null, parts };
}

/** What the Sun does next: sunset, dark, dawn, sunrise. */
export function nextOfSun(times, now) {
  const all = [["sunset", times.sun_sets_utc], ["dark", times.dark_from_utc], ["dawn", times.dark_until_utc], ["sunrise", times.sun_rises_utc]];
  const found = all.filter(([, utc]) => utc && Date.parse(utc) > now).sort((a, b) => Date.parse(a[1]) - Date.parse(b[1]))[0];
  return found ? { word: found[0], utc: found[1] } : null;
}

export function showHeadline(observatory) {
  let shown = "";
  function show() {
    const { state, sky } = observatory;
    const { target, parts } = headlineParts(sky, state);
    let words = target;
    if (!words) {
      if (!state) words = "–";
      else if (!state.connected) words = "no telescope connected";
      else if (state.parked) words = "parked";
      else words = state.tracking === false ? restWords(state) ?? "at rest" : "no target";
    }
    say(by("headline-target"), words);
    by("headline-target").title = words;
    const age = observatory.readAge();
    document.body.classList.toggle("old", observatory.lostSince === null && age !== null && age > READ_OLD_S);
    const key = JSON.stringify(parts);
    if (key === shown) return;
    shown = key;
    fill(by("headline-figures"), ...parts.flatMap((one, i) => [
      i ? element("span", { class: "sep", "aria-hidden": "true" }, "·") : null,
      element("b", { class: one.old ? "old" : "" }, one.text)]));
    by("headline-figures").title = parts.map((one) => one.text).join(" · ");
  }
  for (const topic of ["state", "sky", "link", "telescope"]) observatory.on(topic, show);
  show();
}

/** Since when a telescope is still, by the service's clock; null while it moves, or nobody knows. */
export function restWords(state) {
  if (!state?.connected || state.slewing || !state.still_since_utc) return null;
  const since = `${clockOf(state.still_since_utc)} UTC`;
  if (state.tracking === true) return `moves by tracking alone since ${since}`;
  if (state.tracking === false || state.parked) return `at rest since ${since}`;
  return `no motion seen since ${since}`;
}

