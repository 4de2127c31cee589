// Angles as people write and read them: typed coordinates in, sexagesimal out. Nothing is guessed silently.

// The rules stand in mountnav/sky/typed_coordinates.py, and tests/sky/typed_coordinates.json holds both to them.
const LONGEST_TEXT = 100;
const LABEL = /\b(?:ra|dec|alpha|delta|icrs|j2000)\b *[:=]?|[αδ] *[:=]?/gi;
const NUMBERLIKE = /^[0-9+\-.,; :°'"hmsd]*$/i;
const NUMBER = "(?:[0-9]+(?:\\.[0-9]*)?|\\.[0-9]+)";
// one coordinate, its numbers parted in one way: by colons, by blanks, or by units
const COLONS = new RegExp(`^([+-]?) *(${NUMBER}):(${NUMBER})(?::(${NUMBER}))?$`);
const BLANKS = new RegExp(`^([+-]?) *(${NUMBER})(?: +(${NUMBER})(?: +(${NUMBER}))?)?$`);
const UNITS = new RegExp(`^([+-]?) *(${NUMBER}) *([hd°]) *(?:(${NUMBER}) *[m']? *(?:(?<=[m' ])(${NUMBER}) *[s"]?)?)?$`, "i");
// what may be one coordinate, however its numbers are parted
const ONE = new RegExp(`^[+-]? *${NUMBER} *[hd°:]?(?: *${NUMBER} *[m':]?(?: *${NUMBER} *[s"]?)?)?$`, "i");
const MISSING = "Declination is missing, or it is not clear where it begins: put a comma before it, or its sign.";

const strip = (text) => text.replace(/^ +| +$/g, "");

/** What was typed: {kind: "empty"} | {kind: "place", ra_deg, dec_deg, read} | {kind: "name", name} | {kind: "wrong", why}. */
export function readTarget(text) {
  const plain = strip(text.replace(/[ \t\n\r\u00a0\u2007\u2009\u202f]+/g, " ")
    .replace(/[−–—]/g, "-").replace(/[′’´]/g, "'").replace(/[″”]|''/g, '"').replace(/º/g, "°")
    .replace(/[ʰʱ]/g, "h").replace(/ᵐ/g, "m").replace(/ˢ/g, "s"));
  if (!plain) return { kind: "empty" };
  try {
    if ([...text].length > LONGEST_TEXT) throw new Error(`More than ${LONGEST_TEXT} characters.`);
    const bare = strip(plain.replace(LABEL, " "));
    if (!NUMBERLIKE.test(bare) || !/^[+-]? *[0-9.]/.test(bare)) return { kind: "name", name: plain };
    const [first, second] = parted(bare);
    const ra = readRa(first);
    return { kind: "place", ra_deg: ra.deg, dec_deg: readDec(second), read: ra.hours ? "hours" : "degrees" };
  } catch (wrong) {
    return { kind: "wrong", why: wrong.message };
  }
}

function parted(text) {
  const pieces = text.split(/[,;]/).map(strip);
  if (pieces.length > 2) throw new Error("More than one comma: put one before the declination, and points in numbers.");
  if (pieces.length === 2) {
    if (/(?<![0-9.])[0-9]+,[0-9]+$/.test(text)) throw new Error("Is that comma a decimal point? Put a blank after it if it is not.");
    return pieces;
  }
  const signs = [...text.matchAll(/[+-]/g)].map((one) => one.index).filter((at) => at > 0);
  if (signs.length > 1) throw new Error("There is more than one sign.");
  if (signs.length === 1) return [strip(text.slice(0, signs[0])), strip(text.slice(signs[0]))];
  if (ONE.test(text) && !pointsWithin(text)) throw new Error(MISSING);
  // a coordinate begins after a blank or a unit, never within one's own colons or digits
  const begins = [...text.matchAll(/(?<=[ °'"hmsd])[0-9.]+/gi)].map((one) => one.index);
  const ways = begins.map((at) => [strip(text.slice(0, at)), strip(text.slice(at))])
    .filter(([first, second]) => isCoordinate(first, true) && isCoordinate(second, false));
  if (ways.length !== 1) throw new Error(ways.length || begins.length < 2 ? MISSING : "That can't be read as a position.");
  return ways[0];
}

/** Whether a number before the last one has a decimal point: then it is the last of its coordinate. */
function pointsWithin(text) {
  return [...text.matchAll(new RegExp(NUMBER, "g"))].slice(0, -1).some(([one]) => one.includes("."));
}

function isCoordinate(text, hours) {
  const numbers = numbersOf(text);
  return numbers !== null && !pointsWithin(text) && (hours || numbers.unit !== "h");
}

function numbersOf(text) {
  let found = text.match(COLONS);
  if (found) return { sign: found[1], unit: ":", head: found[2], minutes: found[3], seconds: found[4] };
  found = text.match(UNITS);
  if (found) return { sign: found[1], unit: found[3].toLowerCase() === "h" ? "h" : "°", head: found[2], minutes: found[4], seconds: found[5] };
  found = text.match(BLANKS);
  return found && { sign: found[1], unit: "", head: found[2], minutes: found[3], seconds: found[4] };
}

function sizeOf(name, text) {
  const numbers = numbersOf(text);
  if (numbers === null) throw new Error(`${name} can't be read: "${text}".`);
  if (pointsWithin(text)) throw new Error(`${name}: only the last number may have a point.`);
  const minutes = Number(numbers.minutes ?? 0), seconds = Number(numbers.seconds ?? 0);
  if (minutes >= 60) throw new Error(`${name}: minutes go up to 59.`);
  if (seconds >= 60) throw new Error(`${name}: seconds go up to 59.`);
  return [Number(numbers.head) + minutes / 60 + seconds / 3600, numbers];
}

function readRa(text) {
  const [size, numbers] = sizeOf("Right ascension", text);
  if (numbers.sign === "-") throw new Error("Right ascension has no minus.");
  const hours = numbers.unit === "h" || (numbers.minutes !== undefined && numbers.unit !== "°");
  const alone = numbers.unit === "" && numbers.minutes === undefined;
  if (alone && !numbers.head.includes(".") && size > 0 && size < 24) {
    throw new Error(`Is right ascension ${numbers.head} hours or degrees? Write ${numbers.head}h, ${numbers.head}° or ${numbers.head}.0.`);
  }
  if (size >= (hours ? 24 : 360)) throw new Error(`Right ascension goes up to ${hours ? "24 h" : "360°"}.`);
  return { deg: hours ? size * 15 : size, hours };
}

function readDec(text) {
  const [size, numbers] = sizeOf("Declination", text);
  if (numbers.unit === "h") throw new Error("Declination is in degrees, not in hours.");
  if (size > 90) throw new Error("Declination goes from -90° to +90°.");
  return numbers.sign === "-" ? -size : size;
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

/** An altitude, azimuth or turn, where a tenth of a degree is enough: "−12.3°". */
export function degrees(deg) {
  if (deg === null || deg === undefined || !Number.isFinite(deg)) return "–";
  return `${deg <= -0.05 ? "−" : ""}${Math.abs(deg).toFixed(1)}°`;
}

/** A longer span, to the minute: "2 h 48", "48 min". */
export function hours(seconds) {
  const minutes = Math.max(0, Math.round(seconds / 60));
  return minutes < 60 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")}`;
}

/** Hours and minutes of an instant, UTC. */
export const minuteOf = (utc) => clockOf(utc).slice(0, 5);

/** The service's sentences write places in degrees: shown as all other places here are. */
export function placesIn(words) {
  return words.replace(/RA (\d+\.\d+)° Dec ([+-−]?\d+\.\d+)°/g, (_, ra, dec) => `${hms(Number(ra))} ${dms(Number(dec.replace("−", "-")))}`);
}
