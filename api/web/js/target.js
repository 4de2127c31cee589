// The target as it is typed: read at once, told in full before anything moves, checked by the service.

import { get, Refused } from "./calls.js";
import { by, element, fill, say } from "./elements.js";
import { degrees, dms, hms, readTarget, span } from "./angles.js";

const TYPING_MS = 250;

export function takeTarget(observatory, give) {
  const field = by("target"), list = by("target-names");
  let read = { kind: "empty" }, found = [], chosen = null, marked = -1, typing = null, tellOfSky = "", unasked = "";

  const frame = () => document.querySelector("input[name=frame]:checked").value;

  function target() {
    if (read.kind === "place") return { place: { ra_deg: read.ra_deg, dec_deg: read.dec_deg, frame: frame() } };
    if (read.kind === "name" && chosen) return { name: chosen.name };
    return null;
  }

  function show() {
    const told = by("target-read");
    const ready = (target() !== null || by("elements").value.trim() !== "") && Boolean(observatory.state?.connected) && observatory.lostSince === null;
    by("center").disabled = by("slew").disabled = !ready;
    by("frame-row").classList.toggle("by-name", read.kind === "name");
    told.classList.toggle("bad-text", read.kind === "wrong");
    field.setAttribute("aria-invalid", String(read.kind === "wrong"));
    let words = " ";
    if (read.kind === "wrong") words = read.why;
    else if (read.kind === "place") words = `${hms(read.ra_deg)} ${dms(read.dec_deg)} ${frame() === "icrs" ? "ICRS" : "of date"}, RA read as ${read.read}. ${tellOfSky}`;
    else if (read.kind === "name" && chosen) words = `${chosen.name}: ${where(chosen)}. ${tellOfSky}`;
    else if (read.kind === "name") words = found === null ? unasked || "Looking for that name …" : found.length ? "Choose one of the names." : "No object of that name is known here.";
    say(told, words);
    observatory.tell("target");
  }

  function takeIn() {
    chosen = null;
    tellOfSky = unasked = "";
    by("target-read").classList.remove("warn-text");
    read = readTarget(field.value);
    observatory.asked = read.kind === "place" && frame() === "icrs" ? { ra_deg: read.ra_deg, dec_deg: read.dec_deg } : null;
    clearTimeout(typing);
    close();
    found = [];
    if (read.kind === "name") {
      found = null;
      typing = setTimeout(search, TYPING_MS);
    }
    show();
  }

  async function search() {
    const name = read.name;
    try {
      const told = await get(`/v1/objects?q=${encodeURIComponent(name)}`);
      if (read.kind !== "name" || read.name !== name) return;
      found = Array.isArray(told) ? told : told.objects ?? told.found ?? [];
    } catch (error) {
      if (read.kind !== "name" || read.name !== name) return;
      // no answer is not "no such object"
      found = error instanceof Refused && error.status === 404 ? [] : null;
      unasked = found === null ? `Not looked up: ${error.message}.` : "";
    }
    const same = (found ?? []).find((one) => plain(one.name) === plain(name) || (one.aliases ?? one.names ?? []).some((each) => plain(each) === plain(name)));
    if (same) choose(same, false);
    else open();
    show();
  }

  const plain = (name) => name.toLowerCase().replace(/\s+/g, "");
  const where = (one) => {
    const place = one.icrs ?? one;
    return place.ra_deg === undefined || place.ra_deg === null ? one.kind ?? "" : `${hms(place.ra_deg, 0)} ${dms(place.dec_deg)}`;
  };

  function choose(one, write = true) {
    chosen = one;
    if (write) field.value = one.name;
    if (read.kind !== "name") read = { kind: "name", name: one.name };
    read.name = one.name;
    const place = one.icrs ?? one;
    observatory.asked = place.ra_deg === undefined ? null : { ra_deg: place.ra_deg, dec_deg: place.dec_deg };
    close();
    show();
  }

  function open() {
    marked = -1;
    fill(list, ...(found ?? []).slice(0, 12).map((one, i) => element("li",
      { role: "option", id: `name-${i}`, "aria-selected": "false", onmousedown: (event) => {
        event.preventDefault();
        choose(one);
      } },
      one.name, element("span", {}, [one.kind ?? one.type, where(one)].filter(Boolean).join(" ")))));
    const any = list.childElementCount > 0;
    list.hidden = !any;
    field.setAttribute("aria-expanded", String(any));
  }

  function close() {
    list.hidden = true;
    field.setAttribute("aria-expanded", "false");
    field.removeAttribute("aria-activedescendant");
  }

  function mark(step) {
    const options = [...list.children];
    if (!options.length) return;
    marked = (marked + step + options.length) % options.length;
    options.forEach((one, i) => one.setAttribute("aria-selected", String(i === marked)));
    options[marked].scrollIntoView({ block: "nearest" });
    field.setAttribute("aria-activedescendant", options[marked].id);
  }

  field.addEventListener("input", takeIn);
  field.addEventListener("keydown", (event) => {
    if (list.hidden) return;
    if (event.key === "ArrowDown") mark(1);
    else if (event.key === "ArrowUp") mark(-1);
    else if (event.key === "Escape") close();
    else if (event.key === "Enter" && marked >= 0) choose(found[marked]);
    else return;
    event.preventDefault();
  });
  field.addEventListener("blur", close);
  document.querySelectorAll("input[name=frame]").forEach((one) => one.addEventListener("change", takeIn));
  by("target-form").addEventListener("submit", (event) => {
    event.preventDefault();
    if (!by("center").disabled) give("center", target(), by("center"));
  });
  by("slew").addEventListener("click", () => give("slew", target(), by("slew")));
  document.addEventListener("keydown", (event) => {
    if (event.key !== "/" || event.ctrlKey || event.altKey || event.metaKey || event.target.closest("input, textarea")) return;
    event.preventDefault();
    field.focus();
  });

  observatory.on("sky", () => {
    const asked = observatory.asked && observatory.sky?.asked;
    const said = by("target-read");
    if (!asked) return;
    if (Math.abs(asked.place.dec_deg - observatory.asked.dec_deg) > 1e-6 || Math.abs(asked.place.ra_deg - observatory.asked.ra_deg) > 1e-6) return;
    tellOfSky = asked.allowed
      ? `Now at altitude ${degrees(asked.altitude_deg)}; ${asked.ahead ? `${asked.ahead.limit} limit in ${span(asked.ahead.after_s)}` : "no limit in 12 h"}.`
      : `Not now: ${asked.why}.`;
    said.classList.toggle("warn-text", !asked.allowed);
    show();
  });
  observatory.on("state", show);
  observatory.on("link", () => {
    if (observatory.lostSince !== null) tellOfSky = ""; // of a moment that is over
    show();
  });
  observatory.on("telescope", takeIn);
  by("elements").addEventListener("input", show);
  show();
  /** The target that was typed, as orders take it; null while there is none. */
  return () => {
    const one = target();
    if (!one) return null;
    if (one.name) return { kind: "name", name: one.name };
    return { kind: one.place.frame === "icrs" ? "icrs" : "apparent", ra_deg: one.place.ra_deg, dec_deg: one.place.dec_deg };
  };
}
