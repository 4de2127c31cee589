// The job: what runs or ran last, its steps, how it ended, and a button that ends it.

import { remove } from "./calls.js";
import { by, element, fill, say } from "./elements.js";
import { clockOf, small } from "./angles.js";
import { rateWords } from "./moving.js";

/** A running or ended job, its steps, and a button that ends it. */
export function showJob(observatory) {
  const body = by("job-body");
  function show() {
    const job = observatory.job;
    if (!job) {
      fill(body, element("span", { class: "dim" }, "none yet"));
      return;
    }
    const over = Boolean(job.finished_utc);
    [body.dataset.job, body.dataset.state] = [job.id, job.state];
    const began = Date.parse(job.started_utc ?? job.created_utc);
    const end = over ? Date.parse(job.finished_utc) : observatory.sky ? Date.parse(observatory.sky.utc) : Date.now();
    const seconds = Math.max(0, (end - began) / 1000);
    const tone = { succeeded: "good-text", failed: "bad-text", cancelled: "warn-text" }[job.state] ?? "warn-text";
    const name = job.request?.target?.name;
    const lines = [element("div", { class: "job-line" },
      element("b", {}, name ? `${job.kind} ${name}` : job.kind),
      element("span", { class: tone }, over ? job.state : job.phase),
      element("span", { class: "num" }, job.forgotten ? "" : `${seconds.toFixed(over ? 1 : 0)} s`),
      over ? null : cancelButton(job))];
    const steps = STEPS[job.kind];
    if (steps && !over) lines.push(stepList(steps, job.phase));
    if (job.problem) lines.push(element("p", { class: "bad-text" }, [job.problem.detail, job.problem.advice].filter(Boolean).join(": ")));
    const told = outcome(job.result);
    if (told) lines.push(element("p", {}, told));
    for (const note of job.result?.notes ?? []) lines.push(element("p", { class: "dim" }, note));
    // a button that holds the focus must not be thrown away beneath a finger
    const focused = body.contains(document.activeElement) && !over ? document.activeElement.dataset.job : null;
    fill(body, ...lines);
    if (focused) body.querySelector("button")?.focus();
  }
  function cancelButton(job) {
    return element("button", { type: "button", "data-job": job.id, onclick: (event) => {
      event.target.disabled = true;
      remove(`/v1/jobs/${encodeURIComponent(job.id)}`).catch((error) => {
        event.target.disabled = false;
        by("order-told").className = "bad-text";
        say(by("order-told"), `Cancel: NOT CERTAIN. ${error.message}. Press STOP.`);
      });
    } }, "Cancel");
  }
  for (const topic of ["job", "telescope"]) observatory.on(topic, show);
  show();
}

const STEPS = {
  center: [["slewing", "slewed"], ["exposing"], ["solving", "solved"], ["attempt", "syncing", "synced"]],
  look: [["exposing"], ["solving", "solved"]],
  sync: [["exposing"], ["solving", "solved"], ["syncing", "synced"]],
  recover: [["exposing"], ["solving", "solved"], ["confirmed"], ["syncing", "synced"]],
  "first-light": [["exposing"], ["solving", "solved"], ["confirmed"], ["slewing", "slewed"], ["syncing", "synced"]],
};

function stepList(steps, phase) {
  const now = steps.findIndex((one) => one.includes(phase));
  return element("ol", { id: "job-steps", "aria-label": "Steps" }, ...steps.map(([name], i) => element("li",
    { class: i === now ? "now" : i < now ? "been" : "", "aria-current": i === now ? "step" : null },
    { attempt: "correct", syncing: "sync", confirmed: "confirm" }[name] ?? name.replace(/ing$/, "").replace("solv", "solve").replace("expos", "expose"))));
}

function outcome(result) {
  if (!result) return null;
  if (result.kind === "center") {
    const off = (value) => (value === null ? "unknown" : small(value));
    return `${result.outcome}: from ${off(result.error_before_arcsec)} to ${off(result.error_after_arcsec)} off (tolerance ${off(result.tolerance_arcsec)})`;
  }
  if (result.kind === "look") return `${small(result.offset.total_arcsec)} from the mount's belief, ${result.pairs} stars`;
  if (result.kind === "slew") return `${result.outcome}, ${small(result.miss_arcsec)} by the mount's own reading`;
  if (result.kind === "offset-rates") return result.ends_utc ? `rates ${rateWords(result.ra_arcsec_s)} RA, ${rateWords(result.dec_arcsec_s)} Dec until ${clockOf(result.ends_utc)} UTC` : "tracks as for a star";
  if (result.kind === "axes-moved") return result.axes.map((one) => `${one.axis} axis moved for ${one.moved_s.toFixed(1)} s: ${one.why}`).join("; ");
  return result.outcome ?? null;
}
