// Orders: given by buttons, asked about once where they destroy or move more than was seen, answered in words.

import { Dropped, lease, NoConnection, order } from "./calls.js";
import { hms, dms, span } from "./angles.js";
import { by, say } from "./elements.js";
import { askOnce } from "./question.js";
import { readElements, showMoving } from "./moving.js";
import { takeNudges } from "./nudge.js";
import { takeTarget } from "./target.js";

const NIGHT = "night/";
const NEEDS = { park: ["park"], unpark: ["unpark"], "set-park": ["set-park"], home: ["home", "find-home"], tracking: ["track"] };
const TWICE_MS = 800; // a second click within that time is the tremble of a finger

export function takeOrders(observatory) {
  const given = new Map();

  function told(words, tone = "") {
    const line = by("order-told");
    line.className = tone ? `${tone}-text` : "";
    say(line, words);
  }

  /** Give an order once: not again while it has no answer, nor by a double click. */
  async function once(what, body, name, opener = null) {
    const id = observatory.id, named = `${id} ${what}`, last = given.get(named);
    if (last && (!last.answered || performance.now() - last.at < TWICE_MS)) return;
    const mine = { at: performance.now(), answered: false };
    given.set(named, mine);
    const busy = await give(id, what, body, name);
    mine.answered = true;
    if (busy && observatory.id === id) offer(id, busy, what, body, name, opener);
  }

  /** Another job holds the telescope: whether to end it for this one. */
  function offer(id, error, what, body, name, opener) {
    const job = [observatory.job, ...observatory.jobs].find((one) => one?.id === error.problem.job_id);
    const target = job?.request?.target?.name, now = observatory.now();
    const began = job ? Date.parse(job.started_utc ?? job.created_utc) : null;
    const doing = job ? `${job.kind}${target ? ` ${target}` : ""}${now && began ? `, for ${span((now - began) / 1000)}` : ""}` : "another order";
    told(`${name}: not taken, ${id} is busy (${doing}).`, "warn");
    const goes = ["center", "slew", "follow"].includes(body?.kind ?? what);
    askOnce(`${id} is busy: ${doing}. End that, stop the mount, and ${goes ? "go there" : `${name} (${id})`} instead?`, opener,
      () => once(`${what}?supersede=true`, body, name, opener), goes ? "Go there instead" : `${name} instead`, "Leave it");
  }

  /** Give it; returns the refusal if the telescope is busy and the order may take the place of what runs. */
  async function give(id, what, body, name) {
    const here = () => observatory.id === id; // words about one telescope never stand under another
    const tell = (words, tone) => told(here() ? words : `${id}: ${words}`, tone);
    tell(`${name} …`, "warn");
    try {
      const answer = await order(id, observatory.path(what), body, (n) => tell(`${name}: no answer, asking again (${n}) …`, "warn"));
      if (answer.id) {
        if (here()) {
          observatory.job = answer;
          observatory.tell("job");
          observatory.soon("jobs");
        }
        tell(`${name}: taken`, "good");
      } else {
        if (here()) {
          observatory.night = answer;
          observatory.tell("night");
        }
        tell(`${name}: done`, "good");
      }
    } catch (error) {
      if (error instanceof Dropped) tell(`${name}: ${error.message}. Whether the service took it is not known: see the state.`, "bad");
      else if (error instanceof NoConnection) tell(`${name}: ${error.message}. Whether the service took it is not known: see the state once it answers again.`, "bad");
      else if (error.slug === "busy" && error.problem.job_id && !what.includes("?") && !what.startsWith(NIGHT)) return error;
      else tell(`${name}: refused. ${error.message}`, "bad");
      if (error.slug === "lease-lost") observatory.tell("lease-lost", id, lease.get(id), error);
    }
    if (what.startsWith(NIGHT)) observatory.soon("night");
    return null;
  }

  const typed = takeTarget(observatory, (kind, target) => {
    // what was pasted is meant, whatever the field above still says
    const pasted = readElements(by("elements").value);
    if (pasted) {
      once("jobs", { kind, target: pasted }, `${kind} what was pasted`, by(kind));
      return;
    }
    if (!target) return;
    if (target.name) once("jobs", { kind, target: { kind: "name", name: target.name } }, `${kind} ${target.name}`, by(kind));
    else once(kind, target.place, kind, by(kind));
  });
  showMoving(observatory, typed, (body, name) => once("jobs", body, name, by("follow")));
  takeNudges(observatory, (body, name) => once("jobs", body, name));

  for (const button of document.querySelectorAll("[data-order]")) {
    const what = button.dataset.order;
    button.addEventListener("click", () => {
      const name = button.textContent, body = bodyOf(button);
      if (!button.dataset.ask) once(what, body, name, button);
      else askOnce(`${observatory.id}: ${button.dataset.ask}${button === by("flip") ? ` ${flipWords()}` : ""}`, button, () => once(what, body, name, button));
    });
  }
  function bodyOf(button) {
    if (button === by("tracking")) return { on: observatory.state?.tracking !== true };
    if (button === by("flip")) return { target: flipTarget() };
    if (button.dataset.kind) return { kind: button.dataset.kind };
    return button.dataset.order === "look" ? {} : undefined;
  }

  /** What a flip centers: what the telescope is on, else where it points. */
  function flipTarget() {
    const id = observatory.sky?.headline?.target_job_id;
    const target = observatory.jobs.find((one) => one.id === id)?.request?.target;
    if (target) return target;
    const icrs = observatory.state?.icrs;
    return icrs ? { kind: "icrs", ra_deg: icrs.ra_deg, dec_deg: icrs.dec_deg } : null;
  }

  function flipWords() {
    const target = flipTarget();
    return target ? `Target: ${target.name ?? `${hms(target.ra_deg, 0)} ${dms(target.dec_deg)}`}.` : "";
  }

  observatory.on("telescope", () => told(""));

  function enable() {
    const { state } = observatory;
    const up = Boolean(state?.connected) && observatory.lostSince === null;
    for (const button of document.querySelectorAll("[data-order]")) {
      const what = button.dataset.order;
      // whether an order would be refused now is for the service to say, in words; only what can never be is shut
      const skills = observatory.can?.skills;
      const needs = NEEDS[button.dataset.kind ?? what];
      const never = (skills && needs && !needs.some((one) => skills.includes(one))) || observatory.capabilities?.your_role === "view"
        || (button === by("flip") && observatory.can && observatory.can.mounting !== "german");
      button.disabled = never || (what.startsWith(NIGHT) ? !observatory.night || observatory.lostSince !== null : !up);
    }
  }
  function track() {
    say(by("tracking"), observatory.state?.tracking === true ? "Track off" : "Track on");
  }
  for (const topic of ["state", "telescope"]) observatory.on(topic, track);
  for (const topic of ["state", "link", "night", "capabilities"]) observatory.on(topic, enable);
  track();
  enable();
}
