// Orders: given by buttons, asked about once where they destroy or move more than was seen, answered in words.

import { Dropped, lease, NoConnection, order } from "./calls.js";
import { by, say } from "./elements.js";
import { askOnce } from "./question.js";
import { readElements, showMoving } from "./moving.js";
import { takeTarget } from "./target.js";

const NIGHT = "night/";
const TWICE_MS = 800; // a second click within that time is the tremble of a finger

export function takeOrders(observatory) {
  const given = new Map();

  function told(words, tone = "") {
    const line = by("order-told");
    line.className = tone ? `${tone}-text` : "";
    say(line, words);
  }

  /** Give an order once: not again while it has no answer, nor by a double click. */
  async function once(what, body, name) {
    const id = observatory.id, named = `${id} ${what}`, last = given.get(named);
    if (last && (!last.answered || performance.now() - last.at < TWICE_MS)) return;
    const mine = { at: performance.now(), answered: false };
    given.set(named, mine);
    await give(id, what, body, name);
    mine.answered = true;
  }

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
      else tell(`${name}: refused. ${error.message}`, "bad");
      if (error.slug === "lease-lost") observatory.tell("lease-lost", id, lease.get(id), error);
    }
    if (what.startsWith(NIGHT)) observatory.soon("night");
  }

  const typed = takeTarget(observatory, (kind, target) => {
    // what was pasted is meant, whatever the field above still says
    const pasted = readElements(by("elements").value);
    if (pasted) {
      once("jobs", { kind, target: pasted }, `${kind} what was pasted`);
      return;
    }
    if (!target) return;
    if (target.name) once("jobs", { kind, target: { kind: "name", name: target.name } }, `${kind} ${target.name}`);
    else once(kind, target.place, kind);
  });
  showMoving(observatory, typed, (body, name) => once("jobs", body, name));

  for (const button of document.querySelectorAll("[data-order]")) {
    const what = button.dataset.order, name = button.textContent;
    const body = button.dataset.kind ? { kind: button.dataset.kind } : undefined;
    button.addEventListener("click", () => {
      if (!button.dataset.ask) once(what, what === "look" ? {} : body, name);
      else askOnce(`${observatory.id}: ${button.dataset.ask}`, button, () => once(what, body, name));
    });
  }
  observatory.on("telescope", () => told(""));

  function enable() {
    const { state } = observatory;
    const up = Boolean(state?.connected) && observatory.lostSince === null;
    for (const button of document.querySelectorAll("[data-order]")) {
      const what = button.dataset.order;
      // whether an order would be refused now is for the service to say, in words; only what can never be is shut
      const skills = observatory.can?.skills;
      const never = (skills && ["park", "unpark"].includes(what) && !skills.includes(what)) || observatory.capabilities?.your_role === "view";
      button.disabled = never || (what.startsWith(NIGHT) ? !observatory.night || observatory.lostSince !== null : !up);
    }
  }
  for (const topic of ["state", "link", "night", "capabilities"]) observatory.on(topic, enable);
  enable();
}
