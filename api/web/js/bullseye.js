// The bullseye: where the last solves found the tube, from the target; rings by the logarithm, so that degrees and seconds fit.

import { by, drawn, element, fill, MONO, say } from "./elements.js";
import { small } from "./angles.js";

const RINGS = [1, 3, 10, 30, 60, 300, 600, 1800, 3600, 18000, 36000, 180000];
const SHOWN = 5;

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
    let lastY = y0;
    for (const ring of inner) {
      const y = y0 + reach(ring) * scale;
      if (y - lastY < 13) continue;
      lastY = y;
      const label = ring >= 3600 ? `${ring / 3600}°` : ring >= 60 ? `${ring / 60}′` : `${ring}″`;
      const wide = c.measureText(label).width + 4;
      c.fillStyle = color.panel; // no ring runs through its own number
      c.fillRect(x0 + 14 - wide / 2, y - 7, wide, 13);
      c.fillStyle = color.faint;
      c.fillText(label, x0 + 14, y);
    }

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
          c.fillStyle = color.text;
          c.textAlign = x > x0 ? "right" : "left";
          c.fillText(small(job.attempts[i].error_arcsec), x + (x > x0 ? -9 : 9), y - (y > y0 + R - 12 ? 10 : 0));
          c.textAlign = "center";
        }
      });
    });
    c.globalAlpha = 1;
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
