// The table of attempts: what each look found, and what was done about it; failures with their reason.

import { by, element, fill } from "./elements.js";
import { clockOf, small } from "./angles.js";
import { toleranceOf } from "./bullseye.js";

const JOBS = 12;

export function showAttempts(observatory) {
  function show() {
    const rows = observatory.jobs.slice(0, JOBS).flatMap((job) => rowsOf(job, observatory));
    fill(by("attempt-rows"), ...(rows.length ? rows : [element("tr", {}, element("td", { colspan: 8 }, " "))]));
  }
  for (const topic of ["jobs", "limits", "offsets", "telescope"]) observatory.on(topic, show);
  show();
}

function rowsOf(job, observatory) {
  const rows = [];
  const name = job.request?.target?.name ? `${job.kind} ${job.request.target.name}` : job.kind;
  const tolerance = toleranceOf(observatory, job);
  [...(job.attempts ?? [])].reverse().forEach((one) => {
    const at = observatory.lookTimes.get(one.look_id);
    const tone = (one.error_arcsec ?? Infinity) <= tolerance ? "good-text" : "";
    rows.push(row(at, `${name} ${one.number}`, [
      [small(one.error_arcsec), tone], [small(one.east_arcsec, true)], [small(one.north_arcsec, true)],
      [one.pairs ?? "–"], [one.rms_arcsec === null || one.rms_arcsec === undefined ? "–" : `${one.rms_arcsec.toFixed(2)}″`],
    ], done(one)));
    if (one.why) rows.push(words(one.why));
  });
  const result = job.result;
  const look = result?.kind === "look" ? result : result?.kind === "sync" ? result.look : null;
  if (look) {
    rows.push(row(look.mid_exposure_utc, name, [
      [small(look.offset.total_arcsec)], [small(look.offset.east_arcsec, true)], [small(look.offset.north_arcsec, true)],
      [look.pairs], [look.rms_arcsec === null ? "–" : `${look.rms_arcsec.toFixed(2)}″`],
    ], result.kind === "sync" ? `sync ${result.outcome}` : "from belief"));
  }
  if (job.problem) {
    const failed = row(job.finished_utc ?? job.created_utc, name, [["–"], ["–"], ["–"], ["–"], ["–"]], job.state);
    failed.classList.add("fail");
    rows.unshift(failed, words([job.problem.detail, job.problem.advice].filter(Boolean).join(" – ")));
  }
  rows[0]?.classList.add("first");
  return rows;
}

const done = (one) => {
  const by = one.correction && one.correction !== "none" ? one.correction : one.synced ? "sync" : "";
  return [by, one.slewed ? "slew" : ""].filter(Boolean).join(", ") || "–";
};

function row(utc, name, numbers, what) {
  return element("tr", {},
    element("td", {}, utc ? clockOf(utc) : "–"), element("td", {}, name),
    ...numbers.map(([text, tone]) => element("td", { class: `r ${tone ?? ""}` }, String(text))),
    element("td", {}, what));
}

const words = (text) => element("tr", { class: "why" }, element("td", { colspan: 8 }, element("div", {}, text)));
