// The bullseye: where the last solves found the tube, from the target; rings by the logarithm, so that degrees and seconds fit.

import { by, drawn, element, fill, MONO, say } from "./elements.js";
import { small } from "./angles.js";

const RINGS = [1, 3, 10, 30, 60, 300, 600, 1800, 3600, 18000, 36000, 180000];
const SHOWN = 5;

/** What was written last and where: [{label, box: [left, top, right, bottom]}]. */
export let labels = [];

export const overlaps = (a, b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];

/** How far from the middle an error stands, without a unit. */
const reach = (arcsec) => Math.log10(1 + arcsec / 0.5);

/** The centerings to be shown, newest first: each a list of its attempts. */
export function shots(jobs) {
  return jobs.filter((one) => one.kind !== "follow" && one.attempts?.length).slice(0, SHOWN);
}

export function showBullseye(observatory) {
  const canvas = by("bullseye-map");
  const again = drawn(canvas, (c, width, height, color) => {
    const R = Math.min(width, height) / 2 - 16, x0 = width / 2, y0 = height / 2;
    const series = shots(observatory.jobs);
    const tolerance = toleranceOf(observatory, series[0]);
    const most = Math.max(tolerance * 3, 30, ...series.flatMap((one) => one.attempts.map((each) => each.error_arcsec ?? 0)));
    const outer = RINGS.find((one) => one >= most) ?? most;
    const scale = R / reach(outer);
    const at = (east, north) => {
      const size = Math.hypot(east, north), r = size ? (reach(size) * scale) / size : 0;
      return [x0 - east * r, y0 - north * r];
    };
    c.font = MONO;
    c.textAlign = "center";
    c.textBaseline = "middle";
    const inner = RINGS.filter((one) => one <= outer);
    c.lineWidth = 1;
    for (const ring of inner) {
      c.strokeStyle = ring === outer ? color.line : color.grid;
      c.beginPath();
      c.arc(x0, y0, reach(ring) * scale, 0, 2 * Math.PI);
      c.stroke();
    }
    c.strokeStyle = color.grid;
    c.beginPath();
    c.moveTo(x0 - R, y0);
    c.lineTo(x0 + R, y0);
    c.moveTo(x0, y0 - R);
    c.lineTo(x0, y0 + R);
    c.stroke();
    c.fillStyle = color.dim;
    c.fillText("N", x0, y0 - R - 8);
    c.fillText("E", x0 - R - 8, y0);

    // what counts as centered
    c.save();
    c.beginPath();
    c.arc(x0, y0, reach(tolerance) * scale, 0, 2 * Math.PI);
    c.globalAlpha = 0.1;
    c.fillStyle = color.good;
    c.fill();
    c.globalAlpha = 1;
    c.strokeStyle = color.good;
    c.lineWidth = 1.5;
    c.stroke();
    c.restore();
    // points first: labels keep clear of them, and of each other
    const boxes = series.flatMap((job) => job.attempts.map((one) => at(one.east_arcsec ?? 0, one.north_arcsec ?? 0))).map(([x, y]) => [x - 6, y - 6, x + 6, y + 6]);
    const ringLabels = [];
    for (const ring of inner) {
      const label = ring >= 3600 ? `${ring / 3600}°` : ring >= 60 ? `${ring / 60}′` : `${ring}″`;
      const half = c.measureText(label).width / 2 + 3, r = reach(ring) * scale;
      for (const turn of [45, 135, 225, 315, 20, 70, 110, 160, 200, 250, 290, 340]) {
        const x = x0 + r * Math.sin((turn * Math.PI) / 180), y = y0 + r * Math.cos((turn * Math.PI) / 180);
        const box = [x - half, y - 7, x + half, y + 7];
        if (box[0] < 1 || box[2] > width - 1 || box[3] > height - 1 || boxes.some((one) => overlaps(one, box))) continue;
        boxes.push(box);
        ringLabels.push([label, x, y, half]);
        break;
      }
    }
    for (const [label, x, y, half] of ringLabels) {
      c.fillStyle = color.panel; // no ring runs through its own number
      c.fillRect(x - half, y - 7, 2 * half, 14);
      c.fillStyle = color.dim;
      c.fillText(label, x, y);
    }
    const placed = ringLabels.map(([label, x, y, half]) => ({ label, box: [x - half, y - 7, x + half, y + 7] }));

    series.map((job, age) => [job, age]).reverse().forEach(([job, age]) => {
      const points = job.attempts.map((one) => at(one.east_arcsec ?? 0, one.north_arcsec ?? 0));
      c.globalAlpha = age ? 0.45 / age : 1;
      c.strokeStyle = age ? color.dim : color.accent;
      c.lineWidth = age ? 1 : 1.5;
      c.beginPath();
      points.forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
      c.stroke();
      points.forEach(([x, y], i) => {
        const last = i === points.length - 1;
        const within = (job.attempts[i].error_arcsec ?? Infinity) <= tolerance;
        c.fillStyle = age ? color.dim : within ? color.good : last ? color.hot : color.accent;
        c.beginPath();
        c.arc(x, y, !age && last ? 5 : 3, 0, 2 * Math.PI);
        c.fill();
        if (!age && (i === 0 || last)) {
          const label = small(job.attempts[i].error_arcsec), half = c.measureText(label).width / 2 + 2;
          const spots = [[half + 8, 0], [-half - 8, 0], [0, -16], [0, 16], [half + 6, -14], [half + 6, 14], [-half - 6, -14], [-half - 6, 14], [half + 14, -26], [-half - 14, 26]];
          const spot = spots.map(([dx, dy]) => [x + dx - half, y + dy - 7, x + dx + half, y + dy + 7])
            .find((box) => box[0] > 0 && box[2] < width && box[1] > 0 && box[3] < height && !boxes.some((one) => overlaps(one, box)));
          if (spot) {
            boxes.push(spot);
            placed.push({ label, box: spot });
            c.fillStyle = color.text;
            c.fillText(label, (spot[0] + spot[2]) / 2, (spot[1] + spot[3]) / 2);
          }
        }
      });
    });
    c.globalAlpha = 1;
    labels = placed;
  });

  function show() {
    const newest = shots(observatory.jobs)[0];
    const tolerance = toleranceOf(observatory, newest);
    const last = newest?.attempts.at(-1);
    say(by("bullseye-note"), last ? `${small(last.error_arcsec)} of ±${small(tolerance)}` : "");
    canvas.setAttribute("aria-label", last
      ? `Bullseye: the last solve is ${small(last.error_arcsec)} from the target, ${small(last.east_arcsec, true)} east, ${small(last.north_arcsec, true)} north; the tolerance is ${small(tolerance)}`
      : "Bullseye: no centering yet");
    if (!by("bullseye-legend").childElementCount) {
      fill(by("bullseye-legend"), ...[["good", "tolerance"], ["accent", "tries of the last centering"], ["dim", "earlier"]].map(
        ([hue, what]) => element("i", { class: `hue-${hue}` }, what)));
    }
    again();
  }
  for (const topic of ["jobs", "job", "limits", "telescope"]) observatory.on(topic, show);
}

export function toleranceOf(observatory, job) {
  return job?.result?.tolerance_arcsec ?? job?.request?.tolerance_arcsec ?? observatory.limits?.tolerance_arcsec ?? 30;
}
