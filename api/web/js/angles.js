// Angles as people write and read them: typed coordinates in, sexagesimal out. Nothing is guessed silently.

const NUMBERLIKE = /^[\d+\-.,;\s:°'"hmsd]*$/i;

/** What was typed: {kind: "empty"} | {kind: "place", ra_deg, dec_deg, read} | {kind: "name", name} | {kind: "wrong", why}. */
export function readTarget(text) {
  const plain = text.trim()
    .replace(/[−–—]/g, "-").replace(/[′’´]/g, "'").replace(/[″”]|''/g, '"').replace(/º/g, "°")
    .replace(/[ʰʱ]/g, "h").replace(/ᵐ/g, "m").replace(/ˢ/g, "s");
  if (!plain) return { kind: "empty" };
  const bare = plain.replace(/\b(ra|dec|alpha|delta|icrs|j2000)\b\s*[:=]?/gi, " ").replace(/[αδ]\s*[:=]?/g, " ").trim();
  if (!NUMBERLIKE.test(bare) || !/^[+-]?[\d.]/.test(bare)) return { kind: "name", name: plain };
  try {
    const [first, second] = halves(bare);
    const ra = readAngle(first, true), dec = readAngle(second, false);
    return { kind: "place", ra_deg: ra.deg, dec_deg: dec.deg, read: ra.hours ? "hours" : "degrees" };
  } catch (wrong) {
    return { kind: "wrong", why: wrong.message };
  }
}

function halves(text) {
  const parts = text.split(/[,;]/).map((one) => one.trim()).filter(Boolean);
  if (parts.length === 2) return parts;
  if (parts.length > 2) throw new Error("More than one comma: put one between right ascension and declination, and points in numbers.");
  const signs = [...text.matchAll(/[+-]/g)].filter((one) => one.index > 0);
  if (signs.length > 1) throw new Error("There is more than one sign.");
  if (signs.length === 1) return [text.slice(0, signs[0].index), text.slice(signs[0].index)];
  const numbers = [...text.matchAll(/[\d.]+/g)];
  if (numbers.length < 2) throw new Error("Declination is missing.");
  if (numbers.length % 2 || numbers.length > 6) {
    throw new Error("Where does right ascension end? Put a comma, or the declination's sign.");
  }
  const at = numbers[numbers.length / 2].index;
  return [text.slice(0, at), text.slice(at)];
}

function readAngle(text, isRa) {
  const name = isRa ? "Right ascension" : "Declination";
  const found = text.trim().match(/^([+-]?)\s*(\d+(?:\.\d*)?|\.\d+)\s*([hd°:]?)\s*(?:(\d+(?:\.\d*)?)\s*([m':]?)\s*(?:(\d+(?:\.\d*)?)\s*(s|"|)\s*)?)?$/i);
  if (!found) throw new Error(`${name} can't be read: "${text.trim()}".`);
  const [, sign, head, unit, minutes, , seconds] = found;
  const sexagesimal = minutes !== undefined;
  const hours = unit.toLowerCase() === "h" || (isRa && sexagesimal && (unit === "" || unit === ":"));
  if (!isRa && unit.toLowerCase() === "h") throw new Error("Declination is in degrees, not in hours.");
  if (sexagesimal && head.includes(".")) throw new Error(`${name}: only the last number may have a point.`);
  if (seconds !== undefined && minutes.includes(".")) throw new Error(`${name}: only the last number may have a point.`);
  if (Number(minutes ?? 0) >= 60) throw new Error(`${name}: minutes go up to 59.`);
  if (Number(seconds ?? 0) >= 60) throw new Error(`${name}: seconds go up to 59.`);
  const size = Number(head) + Number(minutes ?? 0) / 60 + Number(seconds ?? 0) / 3600;
  if (isRa) {
    if (sign === "-") throw new Error("Right ascension has no minus.");
    if (hours ? size >= 24 : size >= 360) throw new Error(`Right ascension goes up to ${hours ? "24 h" : "360°"}.`);
    return { deg: hours ? size * 15 : size, hours };
  }
  if (size > 90) throw new Error("Declination goes from -90° to +90°.");
  return { deg: sign === "-" ? -size : size, hours: false };
}

function parts(value, digits) {
  const unit = 10 ** digits;
  let rest = Math.round(value * 3600 * unit);
  const seconds = rest % (60 * unit);
  rest = (rest - seconds) / (60 * unit);
  return [Math.floor(rest / 60), rest % 60, seconds / unit];
}

const pad = (value, digits) => value.toFixed(digits).padStart(digits ? digits + 3 : 2, "0");

/** Right ascension or a time of day: "05h34m31.9s". */
export function hms(deg, digits = 1) {
  if (deg === null || deg === undefined) return null;
  const [h, m, s] = parts((((deg % 360) + 360) % 360) / 15, digits);
  return `${pad(h % 24, 0)}h${pad(m, 0)}m${pad(s, digits)}s`;
}

/** Declination, altitude: "+22°00′52″". */
export function dms(deg, digits = 0, plus = "+") {
  if (deg === null || deg === undefined) return null;
  const [d, m, s] = parts(Math.abs(deg), digits);
  return `${deg < 0 ? "−" : plus}${pad(d, 0)}°${pad(m, 0)}′${pad(s, digits)}″`;
}

/** An hour angle: "−01h12m03s", west positive. */
export function hourAngle(deg) {
  if (deg === null || deg === undefined) return null;
  const [h, m, s] = parts(Math.abs(deg) / 15, 0);
  return `${deg < 0 ? "−" : "+"}${pad(h, 0)}h${pad(m, 0)}m${pad(s, 0)}s`;
}

/** A small angle in the unit that suits it: 3.2″, 4.1′, 1.25°. */
export function small(arcsec, sign = false) {
  if (arcsec === null || arcsec === undefined || !Number.isFinite(arcsec)) return "–";
  const size = Math.abs(arcsec), mark = arcsec < 0 ? "−" : sign ? "+" : "";
  if (size < 99.95) return `${mark}${size.toFixed(1)}″`;
  if (size < 5997) return `${mark}${(size / 60).toFixed(1)}′`;
  return `${mark}${(size / 3600).toFixed(2)}°`;
}

/** A span of time: "42 s", "5 min 03 s", "3 h 20 min". */
export function span(seconds) {
  if (seconds === null || seconds === undefined) return null;
  const whole = Math.max(0, Math.round(seconds));
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${String(whole % 60).padStart(2, "0")} s`;
  return `${Math.floor(whole / 3600)} h ${String(Math.floor((whole % 3600) / 60)).padStart(2, "0")} min`;
}

/** The time of day of an instant, UTC. */
export const clockOf = (utc) => new Date(utc).toISOString().slice(11, 19);
