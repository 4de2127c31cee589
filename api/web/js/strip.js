// The night as a strip: altitudes over twilight, pointing error, width of stars, zero point, and what was done when.

import { by, drawn, element, fill, MONO, say } from "./elements.js";
import { clockOf, degrees, minuteOf, placesIn, small } from "./angles.js";

const TWILIGHTS = [[-18, 0.0], [-12, 0.1], [-6, 0.2], [-0.833, 0.32], [91, 0.5]];
const LEFT = 62, RIGHT = 10, TOP = 4, BOTTOM = 16, GAP = 5, NEAR_PX = 7;

/** Where values of a row lie: [low, high], never of no height. */
export function rangeOf(values, least) {
  const known = values.filter((one) => one !== null && Number.isFinite(one));
  if (!known.length) return null;
  const low = Math.min(...known), high = Math.max(...known), middle = (low + high) / 2, half = Math.max((high - low) / 2, least / 2) * 1.1;
  return [middle - half, middle + half];
}

/** A zero point as if the exposure had been 1 s: exposures of different length can be compared. */
export const zeroPoint = (look) => (look.zero_point_mag === null || !look.exposure_s ? null : look.zero_point_mag - 2.5 * Math.log10(look.exposure_s));

export function showStrip(observatory) {
  const canvas = by("strip-map");
  let marks = [], pointed = null;

  const again = drawn(canvas, (c, width, height, color) => {
    const { tonight } = observatory;
    marks = [];
    c.font = MONO;
    if (!tonight) return;
    const begin = Date.parse(tonight.from_utc), end = Date.parse(tonight.until_utc);
    const x = (utc) => LEFT + ((Date.parse(utc) - begin) / (end - begin)) * (width - LEFT - RIGHT);
    const room = height - TOP - BOTTOM - 3 * GAP, sizes = [0.46, 0.2, 0.17, 0.17].map((share) => share * room);
    const rows = [];
    let y = TOP;
    for (const size of sizes) {
      rows.push([y, y + size]);
      y += size + GAP;
    }
    drawSky(c, color, tonight, x, rows[0], width);
    const looks = tonight.looks.filter((one) => one.solved);
    drawRow(c, color, { name: "error", values: looks.map((one) => one.error_arcsec), hue: color.accent, log: true, words: (v) => small(v) }, looks, x, rows[1], width);
    drawRow(c, color, { name: "FWHM", values: looks.map((one) => one.fwhm_arcsec), hue: color.good, least: 0.4, words: (v) => small(v) }, looks, x, rows[2], width);
    drawRow(c, color, { name: "zero pt", values: looks.map(zeroPoint), hue: color.hot, least: 0.2, words: (v) => `${v.toFixed(2)}ᵐ` }, looks, x, rows[3], width);
    // what was not solved, at the foot of the errors
    c.strokeStyle = color.bad;
    for (const one of tonight.looks.filter((each) => !each.solved)) cross(c, x(one.utc), rows[1][1] - 4);
    const acts = rows[0];
    for (const act of tonight.acts) {
      const at = x(act.utc);
      if (at < LEFT) continue;
      c.strokeStyle = act.trouble ? color.bad : color.dim;
      c.globalAlpha = act.trouble ? 1 : 0.7;
      c.lineWidth = act.trouble ? 2 : 1;
      c.beginPath();
      c.moveTo(at, acts[1]);
      c.lineTo(at, acts[1] - (act.trouble ? 14 : 8));
      c.stroke();
      marks.push({ x: at, words: `${clockOf(act.utc)} ${placesIn(act.words)}` });
    }
    c.globalAlpha = 1;
    for (const one of tonight.looks) {
      const words = one.solved
        ? [`${clockOf(one.utc)} look`, one.error_arcsec === null ? "" : `${small(one.error_arcsec)} from belief`, one.fwhm_arcsec === null ? "" : `FWHM ${small(one.fwhm_arcsec)}`,
          zeroPoint(one) === null ? "" : `zero point ${zeroPoint(one).toFixed(2)}ᵐ`].filter(Boolean).join(", ")
        : `${clockOf(one.utc)} look not solved`;
      marks.push({ x: x(one.utc), words });
    }
    drawHours(c, color, begin, end, x, rows, height);
    const now = x(tonight.utc);
    c.strokeStyle = color.text;
    c.lineWidth = 1.5;
    c.beginPath();
    c.moveTo(now, TOP);
    c.lineTo(now, height - BOTTOM);
    c.stroke();
    if (pointed !== null) {
      c.strokeStyle = color.faint;
      c.setLineDash([2, 3]);
      c.beginPath();
      c.moveTo(pointed, TOP);
      c.lineTo(pointed, height - BOTTOM);
      c.stroke();
      c.setLineDash([]);
    }
  });

  function legend() {
    const { tonight } = observatory, box = by("strip-legend");
    if (pointed !== null && marks.length) {
      const near = marks.filter((one) => Math.abs(one.x - pointed) < NEAR_PX).slice(0, 3);
      if (near.length) {
        fill(box, element("span", { class: "num" }, near.map((one) => one.words).join(" · ")));
        delete box.dataset.key;
        return;
      }
    }
    if (box.dataset.key === "1" || !tonight) return;
    box.dataset.key = "1";
    fill(box, ...[["warn", "target's altitude"], ["bad", "lowest allowed"], ["dim", "Moon; ticks: what was done"], ["accent", "seen from believed"]].map(
      ([hue, what]) => element("i", { class: `hue-${hue}` }, what)));
  }

  function show() {
    const { tonight } = observatory;
    if (!tonight) delete by("strip-legend").dataset.key;
    say(by("strip-note"), tonight ? `${tonight.moon_lit_percent.toFixed(0)} % of the Moon lit${tonight.cut ? " · the newest alone" : ""}` : "");
    canvas.setAttribute("aria-label", words(tonight));
    legend();
    again();
  }

  canvas.addEventListener("pointermove", (event) => {
    pointed = event.offsetX;
    legend();
    again();
  });
  canvas.addEventListener("pointerleave", () => {
    pointed = null;
    legend();
    again();
  });
  for (const topic of ["tonight", "telescope"]) observatory.on(topic, show);
  show();
}

function words(tonight) {
  if (!tonight) return "The night: not read yet";
  const { times } = tonight;
  const parts = [`The night from ${minuteOf(tonight.from_utc)} to ${minuteOf(tonight.until_utc)} UTC`];
  if (times.dark_from_utc && times.dark_until_utc) parts.push(`dark from ${minuteOf(times.dark_from_utc)} to ${minuteOf(times.dark_until_utc)}`);
  const solved = tonight.looks.filter((one) => one.solved), last = solved.at(-1);
  parts.push(`${solved.length} of ${tonight.looks.length} looks solved`);
  if (last?.fwhm_arcsec) parts.push(`the last one's stars ${small(last.fwhm_arcsec)} wide`);
  parts.push(`${tonight.acts.filter((one) => one.trouble).length} troubles`);
  const here = tonight.sky.find((one) => Date.parse(one.utc) >= Date.parse(tonight.utc));
  if (here && here.target_altitude_deg !== null) parts.push(`target ${degrees(here.target_altitude_deg)} high`);
  return parts.join("; ");
}

function drawSky(c, color, tonight, x, [top, bottom], width) {
  const sky = tonight.sky, y = (alt) => bottom - (Math.max(0, Math.min(90, alt)) / 90) * (bottom - top);
  // twilight behind all: the brighter, the higher the Sun
  c.fillStyle = color.raised;
  c.fillRect(LEFT, top, width - LEFT - RIGHT, bottom - top);
  c.fillStyle = color.hot;
  const share = document.documentElement.dataset.night === undefined ? 0.8 : 0.4; // red eyes want a dark page
  for (let i = 1; i < sky.length; i++) {
    const sun = (sky[i].sun_altitude_deg + sky[i - 1].sun_altitude_deg) / 2;
    c.globalAlpha = share * TWILIGHTS.find(([below]) => sun < below)[1];
    const from = Math.round(x(sky[i - 1].utc)), to = Math.round(x(sky[i].utc));
    if (c.globalAlpha) c.fillRect(from, top, to - from, bottom - top);
  }
  c.globalAlpha = 1;
  c.strokeStyle = color.grid;
  c.fillStyle = color.dim;
  c.textAlign = "right";
  c.textBaseline = "middle";
  c.lineWidth = 1;
  for (const alt of [30, 60]) {
    c.beginPath();
    c.moveTo(LEFT, y(alt));
    c.lineTo(width - RIGHT, y(alt));
    c.stroke();
    if (bottom - top > 50) c.fillText(`${alt}°`, LEFT - 6, y(alt));
  }
  const line = (of, stroke, dash = [], thick = 1.5) => {
    c.strokeStyle = stroke;
    c.setLineDash(dash);
    c.lineWidth = thick;
    c.beginPath();
    let open = false;
    for (const one of sky) {
      const alt = of(one);
      if (alt === null || alt < 0) {
        open = false;
        continue;
      }
      if (open) c.lineTo(x(one.utc), y(alt));
      else c.moveTo(x(one.utc), y(alt));
      open = true;
    }
    c.stroke();
    c.setLineDash([]);
  };
  line((one) => one.moon_altitude_deg, color.dim, [2, 3]);
  line((one) => one.lowest_deg, color.bad, [5, 3], 1);
  line((one) => one.target_altitude_deg, color.warn, [], 2);
}

function drawRow(c, color, { name, values, hue, log, least, words }, looks, x, [top, bottom], width) {
  c.fillStyle = color.raised;
  c.fillRect(LEFT, top, width - LEFT - RIGHT, bottom - top);
  c.textAlign = "right";
  c.textBaseline = "middle";
  c.fillStyle = color.dim;
  const scaled = log ? values.map((one) => (one === null ? null : Math.log10(Math.max(0.1, one)))) : values;
  const range = rangeOf(scaled, log ? 1 : least), tall = bottom - top > 26;
  c.fillText(name, LEFT - 6, tall ? top + 6 : (top + bottom) / 2);
  if (!range) {
    c.textAlign = "left";
    c.fillStyle = color.faint;
    c.fillText("nothing yet", LEFT + 6, (top + bottom) / 2);
    return;
  }
  const last = values.findLast((one) => one !== null);
  if (tall) {
    c.fillStyle = color.text;
    c.fillText(words(last), LEFT - 6, bottom - 7);
  }
  c.fillStyle = hue;
  looks.forEach((one, i) => {
    if (scaled[i] === null) return;
    const y = bottom - 2 - ((scaled[i] - range[0]) / (range[1] - range[0])) * (bottom - top - 4);
    c.fillRect(x(one.utc) - 1.5, y - 1.5, 3, 3);
  });
}

function drawHours(c, color, begin, end, x, rows, height) {
  const hour = 3_600_000, step = (end - begin) / hour > 16 ? 3 : (end - begin) / hour > 9 ? 2 : 1;
  c.fillStyle = color.dim;
  c.strokeStyle = color.grid;
  c.textAlign = "center";
  c.textBaseline = "alphabetic";
  c.lineWidth = 1;
  for (let at = Math.ceil(begin / hour) * hour; at < end; at += hour) {
    const px = x(new Date(at).toISOString());
    for (const [top, bottom] of rows) {
      c.beginPath();
      c.moveTo(px, top);
      c.lineTo(px, bottom);
      c.stroke();
    }
    if (new Date(at).getUTCHours() % step === 0 && px > LEFT + 12) c.fillText(minuteOf(at), px, height - 4);
  }
}

function cross(c, x, y) {
  c.lineWidth = 1.5;
  c.beginPath();
  c.moveTo(x - 3, y - 3);
  c.lineTo(x + 3, y + 3);
  c.moveTo(x - 3, y + 3);
  c.lineTo(x + 3, y - 3);
  c.stroke();
}
