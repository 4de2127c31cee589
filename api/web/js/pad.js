// Keys that move an axis while they are held, and not a moment longer: each repeat is a dead man's switch.
//
// Released, out of focus, out of sight, a STOP, an answer that doesn't come: all of them end it here. Where nothing can be
// sent any more the service ends it, since no further repeat comes; and if the service dies, the mount's guard does.

import { Dropped, get, lease, moveAxis, NoConnection } from "./calls.js";
import { by, element, fill, say } from "./elements.js";

const REPEAT_MS = 300;
const FOR_S = 1.0; // after a lost repeat it goes on for so long at most
const PATIENCE_MS = 900;
const SPEEDS = ["Guide", "Center", "Find", "Fast"];
const KEYS = {
  north: { axis: "secondary", side: 1, words: "North", altaz: "Up" },
  west: { axis: "primary", side: -1, words: "West", altaz: "Left" },
  east: { axis: "primary", side: 1, words: "East", altaz: "Right" },
  south: { axis: "secondary", side: -1, words: "South", altaz: "Down" },
};

export function takePad(observatory) {
  const pad = by("pad"), told = by("pad-told"), speeds = by("pad-speeds");
  let held = null, speed = 2;

  const ladder = (axis) => observatory.can?.axis_speeds_deg_s?.[axis] ?? [];
  const words = (text, tone = "") => {
    told.className = tone ? `${tone}-text` : "dim";
    say(told, text);
  };

  /** Hold a key: one at a time, from here to its end. */
  function hold(button) {
    if (held || button.disabled) return;
    const { axis, side, words: name } = KEYS[button.dataset.pad];
    const rate = side * (ladder(axis)[speed] ?? 0);
    if (!rate) return;
    const mine = { id: observatory.id, axis, rate, name, button, over: false };
    held = mine;
    button.classList.add("held");
    words(`${name}: moving at ${Math.abs(rate).toPrecision(2)}°/s while it is held`, "warn");
    repeat(mine);
  }

  async function repeat(mine) {
    while (held === mine) {
      const next = new Promise((done) => setTimeout(done, REPEAT_MS));
      try {
        const job = await moveAxis(mine.id, body(mine, mine.rate), PATIENCE_MS);
        if (held !== mine) break;
        mine.job = job.id;
        refuse(job);
      } catch (error) {
        if (held !== mine) break;
        release(mine, await whyEnded(mine, error));
        return;
      }
      await next;
    }
  }

  /** Repeats go into the first one's job alone: one that comes late, when it has ended, moves nothing. */
  const body = (mine, rate) => ({ axis: mine.axis, rate_deg_s: rate, for_s: FOR_S, ...(mine.job ? { job_id: mine.job } : {}) });

  /** A repeat that was refused since the motion has ended: the job knows why. */
  async function whyEnded(mine, error) {
    if (error.slug !== "bad-request" || !mine.job) return error;
    mine.ended = true;
    try {
      refuse(await get(`/v1/jobs/${encodeURIComponent(mine.job)}`));
    } catch (found) {
      return found;
    }
    return new Error("the service heard nothing in time: press it again");
  }

  /** A motion that was refused, stopped, or ended by the mount doesn't begin again by itself. */
  function refuse(job) {
    if (job.problem) throw new Error([job.problem.detail, job.problem.advice].filter(Boolean).join(": "));
    const ended = job.result?.axes?.find((one) => one.why.startsWith("the mount ended it"));
    if (ended) throw new Error(ended.why);
  }

  /** End it. What went wrong with it, if anything, is told; the mount is told in any case. */
  async function release(mine, error = null) {
    if (!mine || mine.over) return;
    mine.over = true;
    if (held === mine) held = null;
    mine.button.classList.remove("held");
    if (error) words(`${mine.name}: ended. ${error.message}`, "bad");
    if (error?.slug === "lease-lost") observatory.tell("lease-lost", mine.id, lease.get(mine.id), error);
    if (mine.ended) return;
    try {
      await moveAxis(mine.id, body(mine, 0), PATIENCE_MS);
      if (!error && !held) words(`${mine.name}: ended`, "");
    } catch (failure) {
      if (held || failure instanceof Dropped) return;
      // the last repeat runs out by itself
      const lost = failure instanceof NoConnection;
      if (!error || lost) words(lost ? `${mine.name}: no answer. The service ends it within ${FOR_S} s; if it moves on, STOP.` : `${mine.name}: ended. ${failure.message}`, lost ? "bad" : "");
    }
  }

  const end = () => release(held);
  for (const button of pad.querySelectorAll("[data-pad]")) {
    button.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      event.preventDefault();
      button.focus({ preventScroll: true });
      button.setPointerCapture(event.pointerId);
      hold(button);
    });
    for (const over of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(over, end);
    button.addEventListener("contextmenu", (event) => event.preventDefault()); // of a long touch
    button.addEventListener("keydown", (event) => {
      if (event.key !== " " && event.key !== "Enter") return;
      event.preventDefault();
      if (!event.repeat) hold(button);
    });
    button.addEventListener("keyup", (event) => {
      if (event.key === " " || event.key === "Enter") end();
    });
    button.addEventListener("blur", end);
  }
  window.addEventListener("blur", end);
  window.addEventListener("pagehide", end);
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) end();
  });
  observatory.on("stopping", end);
  observatory.on("telescope", () => {
    end();
    words("");
  });

  function enable() {
    const { state } = observatory;
    const can = Boolean(observatory.can?.skills.includes("move-axis"));
    pad.hidden = observatory.can !== undefined && !can; // its room is kept until that is known
    const up = Boolean(state?.connected) && observatory.lostSince === null && observatory.capabilities?.your_role !== "view";
    const altaz = observatory.can?.mounting === "altaz";
    for (const button of pad.querySelectorAll("[data-pad]")) {
      const { axis, words: name, altaz: other } = KEYS[button.dataset.pad];
      button.disabled = !up || !ladder(axis).length;
      say(button.querySelector("span"), altaz ? other : name);
    }
    if (held && (!up || observatory.lostSince !== null)) release(held, new Error("the connection was lost"));
    const given = ladder("secondary").length ? ladder("secondary") : ladder("primary");
    const named = given.map((one, i) => [SPEEDS[i], one]).filter(([name]) => name);
    if (!given.length || speeds.dataset.made === JSON.stringify(given)) return;
    speeds.dataset.made = JSON.stringify(given);
    speed = Math.min(speed, named.length - 1);
    fill(speeds, ...named.map(([name, one], i) => {
      const input = element("input", { type: "radio", name: "pad-speed", value: String(i), onchange: () => {
        end();
        speed = i;
      } });
      input.checked = i === speed;
      return element("label", { class: "choice", title: `${one.toPrecision(2)}°/s` }, input, element("span", {}, name));
    }));
  }
  for (const topic of ["state", "link", "capabilities", "telescope"]) observatory.on(topic, enable);
  enable();
}
