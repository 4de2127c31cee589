// The last frame: stretched, with the stars measured and identified, the crosses of center and target, north and east.

import { picture } from "./calls.js";
import { by, drawn, element, fill, MONO, say } from "./elements.js";
import { clockOf, small } from "./angles.js";

const RAD = Math.PI / 180;

/** On the frame as shown (x right, y down): the unit steps of north and east. */
export function compass(rotation_deg, parity) {
  const pa = rotation_deg * RAD;
  // +y points to position angle `rotation`; with parity +1 the angle grows counterclockwise
  const north = [Math.sin(pa) * (parity > 0 ? 1 : -1), Math.cos(pa)];
  const east = parity > 0 ? [-north[1], north[0]] : [north[1], -north[0]];
  return { north: [north[0], -north[1]], east: [east[0], -east[1]] };
}

export function showFrame(observatory) {
  const canvas = by("frame-map");
  let image = null, imageOf = null, loading = null;

  const again = drawn(canvas, (c, width, height, color) => {
    const { frame } = observatory;
    c.font = MONO;
    if (!frame) return;
    const scale = Math.min(width / frame.width_px, height / frame.height_px);
    const w = frame.width_px * scale, h = frame.height_px * scale, x0 = (width - w) / 2, y0 = (height - h) / 2;
    if (image && imageOf === frame.frame_id) c.drawImage(image, x0, y0, w, h);
    if (document.documentElement.dataset.night !== undefined) {
      c.globalCompositeOperation = "multiply";
      c.fillStyle = "#c00";
      c.fillRect(x0, y0, w, h);
      c.globalCompositeOperation = "source-over";
    }
    const at = (x, y) => [x0 + (x + 0.5) * scale, y0 + h - (y + 0.5) * scale];
    c.save();
    c.beginPath();
    c.rect(x0, y0, w, h);
    c.clip();
    drawStars(c, color, frame, at);
    drawCrosses(c, color, frame, at, { x0, y0, w, h });
    drawCompass(c, color, frame, { x0, y0, w, h, scale });
    c.restore();
  });

  async function load() {
    const { frame } = observatory;
    describe(canvas, frame);
    again();
    if (!frame || imageOf === frame.frame_id || loading === frame.frame_id) return;
    loading = frame.frame_id;
    try {
      const bitmap = await createImageBitmap(await picture(frame.picture));
      // one that comes when another frame is shown already takes nothing from it
      if (observatory.frame?.frame_id === frame.frame_id) {
        image?.close();
        [image, imageOf] = [bitmap, frame.frame_id];
      } else bitmap.close();
    } catch { /* the next look brings another */ }
    if (loading === frame.frame_id) loading = null;
    again();
  }
  observatory.on("frame", load);
  return again;
}

function drawStars(c, color, frame, at) {
  const identified = frame.stars;
  c.lineWidth = 1;
  c.strokeStyle = color.dim;
  for (const [x, y] of frame.measured_px) {
    if (identified.some((one) => Math.hypot(one.x_px - x, one.y_px - y) < 2)) continue;
    const [px, py] = at(x, y);
    c.strokeRect(px - 4, py - 4, 8, 8);
  }
  for (const star of identified) {
    const [x, y] = at(star.x_px, star.y_px);
    const radius = Math.max(5, 13 - 0.9 * (star.mag ?? 10));
    c.strokeStyle = star.used ? color.good : color.bad;
    c.lineWidth = 1.2;
    c.setLineDash(star.used ? [] : [2, 2]);
    c.beginPath();
    c.arc(x, y, radius, 0, 2 * Math.PI);
    c.stroke();
  }
  c.setLineDash([]);
}

function drawCrosses(c, color, frame, at, { x0, y0, w, h }) {
  const [cx, cy] = at((frame.width_px - 1) / 2, (frame.height_px - 1) / 2);
  c.strokeStyle = color.accent;
  c.lineWidth = 1.5;
  cross(c, cx, cy, 8, 22);
  const target = frame.target;
  if (!target || target.x_px === null) return;
  const [tx, ty] = at(target.x_px, target.y_px);
  c.strokeStyle = c.fillStyle = color.hot;
  const inside = tx > x0 && tx < x0 + w && ty > y0 && ty < y0 + h;
  if (inside) {
    c.beginPath();
    c.arc(tx, ty, 12, 0, 2 * Math.PI);
    c.stroke();
    cross(c, tx, ty, 12, 18);
    c.beginPath();
    c.moveTo(cx, cy);
    c.lineTo(tx, ty);
    c.setLineDash([3, 4]);
    c.stroke();
    c.setLineDash([]);
    return;
  }
  // outside of the frame: an arrow at its edge that says where, and how far
  const angle = Math.atan2(ty - cy, tx - cx), reach = Math.min(w, h) / 2 - 14;
  const [ex, ey] = [cx + reach * Math.cos(angle), cy + reach * Math.sin(angle)];
  arrow(c, cx + 0.8 * reach * Math.cos(angle), cy + 0.8 * reach * Math.sin(angle), ex, ey);
  c.textAlign = "center";
  c.fillText(`target ${small(target.distance_arcsec)}`, cx + 0.62 * reach * Math.cos(angle), cy + 0.62 * reach * Math.sin(angle));
}

function drawCompass(c, color, frame, { x0, y0, w, h, scale }) {
  if (frame.rotation_deg === null || frame.rotation_deg === undefined) return;
  const { north, east } = compass(frame.rotation_deg, frame.parity);
  const length = 26, ox = x0 + w - 52, oy = y0 + h - 48;
  c.strokeStyle = c.fillStyle = color.text;
  c.lineWidth = 1.5;
  c.textAlign = "center";
  c.textBaseline = "middle";
  for (const [name, [dx, dy]] of [["N", north], ["E", east]]) {
    arrow(c, ox, oy, ox + length * dx, oy + length * dy);
    c.fillText(name, ox + (length + 9) * dx, oy + (length + 9) * dy);
  }
  const wanted = (0.18 * w * frame.scale_arcsec_px) / scale;
  const length_arcsec = [1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 7200, 18000].findLast((one) => one <= wanted) ?? 1;
  const bar = (length_arcsec / frame.scale_arcsec_px) * scale;
  c.beginPath();
  c.moveTo(x0 + 14, y0 + h - 18);
  c.lineTo(x0 + 14 + bar, y0 + h - 18);
  c.stroke();
  c.textAlign = "left";
  c.fillText(length_arcsec >= 3600 ? `${length_arcsec / 3600}°` : length_arcsec >= 60 ? `${length_arcsec / 60}′` : `${length_arcsec}″`, x0 + 14, y0 + h - 30);
}

function cross(c, x, y, from, to) {
  c.beginPath();
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
    c.moveTo(x + from * dx, y + from * dy);
    c.lineTo(x + to * dx, y + to * dy);
  }
  c.stroke();
}

function arrow(c, x1, y1, x2, y2) {
  const angle = Math.atan2(y2 - y1, x2 - x1);
  c.beginPath();
  c.moveTo(x1, y1);
  c.lineTo(x2, y2);
  for (const turn of [2.6, -2.6]) {
    c.moveTo(x2, y2);
    c.lineTo(x2 + 6 * Math.cos(angle + turn), y2 + 6 * Math.sin(angle + turn));
  }
  c.stroke();
}

function describe(canvas, frame) {
  if (!frame) {
    say(by("frame-note"), "");
    canvas.setAttribute("aria-label", "No frame yet");
    fill(by("frame-legend"));
    return;
  }
  const when = frame.mid_exposure_utc ? `${clockOf(frame.mid_exposure_utc)} UTC` : "";
  say(by("frame-note"), [when, frame.exposure_s ? `${frame.exposure_s} s` : "", `${frame.width_px}×${frame.height_px}`].filter(Boolean).join(" · "));
  const rejected = frame.stars.filter((one) => !one.used).length;
  const parts = frame.solved
    ? [["good", `${frame.stars.length - rejected} stars identified`], ...(rejected ? [["bad", `${rejected} rejected`]] : []),
      ["dim", `${frame.measured} measured`], ["accent", "center"], ...(frame.target ? [["hot", `target, ${small(frame.target.distance_arcsec)} off`]] : [])]
    : [["bad", `not solved: ${frame.reason}`], ["dim", `${frame.measured} measured`]];
  const facts = frame.solved ? ` ${frame.scale_arcsec_px.toFixed(3)}″/px, turned ${frame.rotation_deg.toFixed(1)}°, rms ${frame.rms_arcsec.toFixed(2)}″, ${frame.solve_s.toFixed(2)} s` : "";
  fill(by("frame-legend"), ...parts.map(([hue, what]) => element("i", { class: `hue-${hue}` }, what)), element("span", { class: "num dim" }, facts));
  canvas.setAttribute("aria-label", `Last frame of ${when}: ${parts.map((one) => one[1]).join(", ")}`);
}
