// The sky over the telescope: zenith in the middle, horizon round it, north up and east left, as one sees it looking up.

import { by, drawn, element, fill, MONO, say } from "./elements.js";
import { degrees, span } from "./angles.js";

const RAD = Math.PI / 180;

/** Where a direction lies on the map, as fractions of its radius. */
export function onMap(altitude_deg, azimuth_deg) {
  const r = (90 - altitude_deg) / 90;
  return [-r * Math.sin(azimuth_deg * RAD), -r * Math.cos(azimuth_deg * RAD)];
}

/** Direction of an hour angle and declination; no refraction. */
export function fromHourAngle(ha_deg, dec_deg, latitude_deg) {
  const [h, d, p] = [ha_deg * RAD, dec_deg * RAD, latitude_deg * RAD];
  const alt = Math.asin(Math.sin(p) * Math.sin(d) + Math.cos(p) * Math.cos(d) * Math.cos(h));
  const az = Math.atan2(-Math.cos(d) * Math.sin(h), Math.sin(d) * Math.cos(p) - Math.cos(d) * Math.sin(p) * Math.cos(h));
  return [alt / RAD, ((az / RAD) + 360) % 360];
}

/** Directions on a circle round a direction. */
export function circleRound(alt_deg, az_deg, radius_deg) {
  const [a, z, r] = [alt_deg * RAD, az_deg * RAD, radius_deg * RAD];
  const points = [];
  for (let turn = 0; turn <= 360; turn += 5) {
    const t = turn * RAD;
    const alt = Math.asin(Math.sin(a) * Math.cos(r) + Math.cos(a) * Math.sin(r) * Math.cos(t));
    const az = z + Math.atan2(Math.sin(t) * Math.sin(r) * Math.cos(a), Math.cos(r) - Math.sin(a) * Math.sin(alt));
    points.push([alt / RAD, ((az / RAD) % 360 + 360) % 360]);
  }
  return points;
}

export function showSkyMap(observatory) {
  const canvas = by("sky-map");
  const trail = [];

  const again = drawn(canvas, (c, width, height, color) => {
    const R = Math.min(width, height) / 2 - 20, x0 = width / 2, y0 = height / 2;
    const at = (alt, az) => {
      const [x, y] = onMap(alt, az);
      return [x0 + x * R, y0 + y * R];
    };
    const path = (points, close = false) => {
      c.beginPath();
      let open = false;
      for (const [alt, az] of points) {
        if (alt < -3) {
          open = false;
          continue;
        }
        const [x, y] = at(alt, az);
        if (open) c.lineTo(x, y);
        else c.moveTo(x, y);
        open = true;
      }
      if (close) c.closePath();
    };
    c.font = MONO;
    c.textAlign = "center";
    c.textBaseline = "middle";
    const { limits, sky } = observatory;

    // the sky itself, and what of it is shut off
    c.fillStyle = color.raised;
    c.beginPath();
    c.arc(x0, y0, R, 0, 2 * Math.PI);
    c.fill();
    c.save();
    c.clip();
    if (limits) drawLimits(c, color, limits, sky, { at, path, R, x0, y0 });
    c.restore();

    c.lineWidth = 1;
    c.strokeStyle = color.line;
    for (const alt of [0, 30, 60]) {
      c.beginPath();
      c.arc(x0, y0, (R * (90 - alt)) / 90, 0, 2 * Math.PI);
      c.stroke();
    }
    for (const az of [0, 90, 180, 270]) {
      c.beginPath();
      c.moveTo(x0, y0);
      c.lineTo(...at(0, az));
      c.stroke();
    }
    c.fillStyle = color.dim;
    for (const [name, az] of [["N", 0], ["E", 90], ["S", 180], ["W", 270]]) c.fillText(name, ...at((-11 * 90) / R, az));
    c.fillStyle = color.faint;
    for (const alt of [30, 60]) c.fillText(`${alt}°`, at(alt, 45)[0], at(alt, 45)[1]);
    if (sky) drawBodies(c, color, sky, at);
    drawWays(c, color, sky, trail, { at, path });
  });

  observatory.on("sky", () => {
    const { sky } = observatory;
    if (sky?.altitude_deg !== null && sky?.altitude_deg !== undefined) {
      const last = trail.at(-1);
      if (!last || Math.hypot(last[0] - sky.altitude_deg, last[1] - sky.azimuth_deg) > 0.3) trail.push([sky.altitude_deg, sky.azimuth_deg]);
      if (trail.length > 400) trail.shift();
    }
    describe(canvas, observatory);
    again();
  });
  observatory.on("limits", again);
  observatory.on("telescope", () => {
    trail.length = 0;
    again();
  });
  return again;
}

function drawLimits(c, color, limits, sky, { at, path, R, x0, y0 }) {
  const shut = color.bg;
  c.fillStyle = shut;
  // below the horizon or the lowest altitude, whichever is higher: a ring with that inner edge
  const points = limits.horizon;
  const horizonAt = (az) => {
    if (!points.length) return -90;
    const next = points.findIndex((one) => one.azimuth_deg > az);
    const b = points[next < 0 ? 0 : next], a = points[(next < 0 ? points.length : next || points.length) - 1];
    const width = (b.azimuth_deg - a.azimuth_deg + 360) % 360 || 360;
    const share = ((az - a.azimuth_deg + 360) % 360) / width;
    return a.altitude_deg + share * (b.altitude_deg - a.altitude_deg);
  };
  const edge = [], ground = [];
  for (let az = 0; az <= 360; az++) {
    ground.push([Math.max(0, horizonAt(az % 360)), az]);
    edge.push([Math.max(limits.min_altitude_deg, horizonAt(az % 360)), az]);
  }
  c.beginPath();
  c.arc(x0, y0, R + 1, 0, 2 * Math.PI);
  for (const [alt, az] of edge.reverse()) c.lineTo(...at(alt, az));
  c.fill("evenodd");
  c.lineWidth = 1.5;
  c.strokeStyle = color.dim;
  if (points.length) {
    path(ground);
    c.stroke();
  }
  c.strokeStyle = color.bad;
  c.lineWidth = 1;
  path(edge);
  c.stroke();
  if (limits.max_altitude_deg < 90) {
    c.fillStyle = shut;
    c.beginPath();
    c.arc(x0, y0, (R * (90 - limits.max_altitude_deg)) / 90, 0, 2 * Math.PI);
    c.fill();
    c.stroke();
  }
  // meridian, and how far past it the tube may go; hour angles and declinations that are shut
  const latitude = limits.latitude_deg;
  const hourCircle = (ha) => Array.from({ length: 91 }, (_, i) => fromHourAngle(ha, -90 + 2 * i, latitude));
  c.setLineDash([2, 5]);
  c.strokeStyle = color.faint;
  path(hourCircle(0));
  c.stroke();
  c.setLineDash([6, 4]);
  c.strokeStyle = color.bad;
  for (const ha of limits.hour_angle_deg ?? []) {
    path(hourCircle(ha));
    c.stroke();
  }
  for (const dec of limits.declination_deg ?? []) {
    path(Array.from({ length: 181 }, (_, i) => fromHourAngle(-180 + 2 * i, dec, latitude)));
    c.stroke();
  }
  if (limits.mounting === "german" && limits.past_meridian_deg) {
    c.strokeStyle = color.warn;
    c.setLineDash([2, 4]);
    for (const ha of [-limits.past_meridian_deg[0], limits.past_meridian_deg[1]]) {
      path(hourCircle(ha));
      c.stroke();
    }
  }
  c.setLineDash([]);
  for (const [body, cone, from] of [["sun", limits.sun_cone_deg, limits.sun_cone_from_altitude_deg], ["moon", limits.moon_cone_deg, 0]]) {
    const seen = sky?.[body];
    if (!seen || !cone || seen.altitude_deg < from) continue;
    path(circleRound(seen.altitude_deg, seen.azimuth_deg, cone), true);
    c.save();
    c.globalAlpha = 0.18;
    c.fillStyle = body === "sun" ? color.bad : color.dim;
    c.fill();
    c.restore();
    c.strokeStyle = body === "sun" ? color.bad : color.dim;
    c.stroke();
  }
}

function drawBodies(c, color, sky, at) {
  for (const [name, body, radius] of [["Sun", sky.sun, 6], ["Moon", sky.moon, 5]]) {
    if (body.altitude_deg < -1) continue;
    const [x, y] = at(body.altitude_deg, body.azimuth_deg);
    c.fillStyle = name === "Sun" ? color.hot : color.dim;
    c.beginPath();
    c.arc(x, y, radius, 0, 2 * Math.PI);
    c.fill();
    c.fillText(name, x, y + 14);
  }
}

function drawWays(c, color, sky, trail, { at, path }) {
  c.lineWidth = 1.5;
  c.strokeStyle = color.faint;
  c.globalAlpha = 0.6;
  path(trail);
  c.stroke();
  c.globalAlpha = 1;
  if (!sky) return;
  c.strokeStyle = color.accent;
  c.globalAlpha = 0.8;
  c.setLineDash([1, 3]);
  path(sky.track.map((one) => [one.altitude_deg, one.azimuth_deg]));
  c.stroke();
  c.globalAlpha = 1;
  c.setLineDash([5, 4]);
  c.strokeStyle = color.warn;
  path(sky.way.map((one) => [one.altitude_deg, one.azimuth_deg]));
  c.stroke();
  c.setLineDash([]);
  const end = sky.ahead && sky.track.at(-1);
  if (end && sky.ahead.after_s <= 6 * 3600) {
    const [x, y] = at(end.altitude_deg, end.azimuth_deg);
    c.strokeStyle = color.bad;
    c.strokeRect(x - 3, y - 3, 6, 6);
  }
  for (const [place, hue, size] of [[sky.target, color.warn, 8], [sky.asked, color.hot, 6]]) {
    if (!place || place.altitude_deg < -1) continue;
    const [x, y] = at(place.altitude_deg, place.azimuth_deg);
    c.strokeStyle = place.allowed ? hue : color.bad;
    c.beginPath();
    c.moveTo(x - size, y);
    c.lineTo(x, y - size);
    c.lineTo(x + size, y);
    c.lineTo(x, y + size);
    c.closePath();
    c.stroke();
  }
  if (sky.altitude_deg === null) return;
  const [x, y] = at(sky.altitude_deg, sky.azimuth_deg);
  c.strokeStyle = color.accent;
  c.lineWidth = 2;
  c.beginPath();
  c.arc(x, y, 7, 0, 2 * Math.PI);
  c.moveTo(x - 12, y);
  c.lineTo(x - 3, y);
  c.moveTo(x + 3, y);
  c.lineTo(x + 12, y);
  c.moveTo(x, y - 12);
  c.lineTo(x, y - 3);
  c.moveTo(x, y + 3);
  c.lineTo(x, y + 12);
  c.stroke();
}

function describe(canvas, { sky, limits }) {
  const known = sky && sky.altitude_deg !== null;
  say(by("sky-note"), known ? `alt ${degrees(sky.altitude_deg)} az ${degrees(sky.azimuth_deg)}` : "");
  const words = ["Map of the sky"];
  if (known) words.push(`telescope at altitude ${sky.altitude_deg.toFixed(0)}, azimuth ${sky.azimuth_deg.toFixed(0)} degrees`);
  if (sky?.target) words.push(`target at altitude ${sky.target.altitude_deg.toFixed(0)}, azimuth ${sky.target.azimuth_deg.toFixed(0)} degrees`);
  if (sky?.ahead) words.push(`${sky.ahead.limit} limit in ${span(sky.ahead.after_s)}`);
  canvas.setAttribute("aria-label", words.join("; "));
  const legend = [["accent", "telescope and where tracking leads"], ["warn", "target"], ["bad", "limits"]];
  if (limits?.sun_cone_deg && sky && sky.sun.altitude_deg >= limits.sun_cone_from_altitude_deg) legend.push(["hot", "Sun and its cone"]);
  const key = legend.map((one) => one[0]).join();
  if (canvas.dataset.legend === key) return;
  canvas.dataset.legend = key;
  fill(by("sky-legend"), ...legend.map(([hue, what]) => element("i", { class: `hue-${hue}` }, what)));
}
