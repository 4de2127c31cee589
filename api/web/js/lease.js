// Control: who holds the telescope that is shown; this page takes it, keeps it by heartbeats, and gives it back.

import { key, lease as kept, leaseCall, NoConnection, Refused } from "./calls.js";
import { by, element, fill, say } from "./elements.js";

// a tab that nobody sees is woken once a minute at worst: three heartbeats must still fit
const TTL_S = 180;
const BEAT_MS = 15_000;
const AGAIN_MS = 3000;
const THEN = { stop: "stop", park: "stop and park", "keep-tracking": "keep tracking" };

export function showControl(observatory) {
  const words = by("control-words"), take = by("control-take"), release = by("control-release"), terms = by("control-terms");
  const releasing = new Set();
  let wake = () => {};

  const held = () => Boolean(observatory.lease?.held);
  const mine = () => Boolean(observatory.id && kept.get(observatory.id));
  const byOther = () => held() && !mine();

  function show() {
    const { lease } = observatory, known = lease !== null && observatory.lostSince === null;
    let text = "not known";
    if (known && !lease.held) text = "Nobody holds the telescope: any key with the role operate may give orders.";
    else if (known && mine()) text = `This page holds the telescope. Should it fall silent for ${lease.ttl_s / 60} min: ${THEN[lease.on_expiry]}.`;
    else if (known && lease.running_out) text = `${holder(lease)} fell silent; now: ${THEN[lease.on_expiry]}.`;
    else if (known) text = `${holder(lease)} holds the telescope. Without a sign of life in ${left(lease)}: ${THEN[lease.on_expiry]}. Orders from here are refused, STOP never.`;
    say(words, text);
    words.className = known && byOther() ? "warn-text" : known && mine() ? "good-text" : "dim";
    const role = observatory.capabilities?.your_role, mayNot = role === "view" || (byOther() && role !== "configure");
    take.hidden = mine() || (byOther() && mayNot);
    say(take, byOther() ? "Break it …" : "Take control …");
    take.disabled = !known || mayNot;
    release.hidden = !mine();
    release.disabled = observatory.lostSince !== null;
    by("control").classList.toggle("mine", known && mine());
    if (take.hidden || take.disabled) open(false);
    if (!terms.hidden) say(by("control-ask"), byOther() ? `This breaks the hold of ${holder(lease)}: the next order from there is refused.` : "Nobody else can give orders then, except STOP.");
  }

  const holder = (lease) => `${lease.holder}${lease.note ? ` (${lease.note})` : ""}`;
  // told in steps, so that nobody is read a new text each second
  const left = (lease) => {
    const seconds = Math.max(0, lease.seconds_left - (Date.now() - lease.heard_ms) / 1000);
    return seconds > 20 ? `${Math.ceil(seconds / 10) * 10} s` : `${Math.ceil(seconds)} s`;
  };

  function open(yes, toFocus = false) {
    terms.hidden = !yes;
    take.setAttribute("aria-expanded", String(yes));
    say(by("control-told"), "");
    if (yes) {
      show();
      by("control-note").focus();
    } else if (toFocus) take.focus();
  }

  async function taken(event) {
    event.preventDefault();
    const id = observatory.id, submit = by("control-yes");
    if (submit.disabled) return;
    submit.disabled = true;
    say(by("control-told"), "");
    try {
      const told = await leaseCall("POST", id, {
        ttl_s: TTL_S, on_expiry: document.querySelector("input[name=on-expiry]:checked").value,
        note: by("control-note").value.trim(), ...(byOther() ? { force: true } : {}),
      });
      kept.use(id, told.lease);
      open(false);
      wake();
    } catch (error) {
      say(by("control-told"), error instanceof NoConnection
        ? `${error.message}. Whether this page has control is not known; if it has, nobody can give orders, except STOP, until that runs out in ${TTL_S / 60} min.` : `Refused: ${error.message}`);
    }
    submit.disabled = false;
    observatory.soon("lease", 0);
    if (id === observatory.id && mine()) release.focus();
  }

  async function given() {
    const id = observatory.id;
    release.disabled = true;
    releasing.add(id);
    try {
      await leaseCall("DELETE", id);
      kept.forget(id);
      releasing.delete(id);
    } catch (error) {
      releasing.delete(id);
      if (error instanceof Refused && error.status === 409) lost(id, kept.get(id), error);
      else say(words, `Not released: ${error.message}`);
    }
    observatory.soon("lease", 0);
  }

  /** The secret that was sent is in force no more; one that was taken meanwhile is left alone. */
  function lost(id, secret, error) {
    if (!secret || kept.get(id) !== secret || releasing.has(id)) return;
    kept.forget(id);
    const banner = by("control-lost");
    banner.hidden = false;
    fill(banner, element("span", {}, `This page holds ${id} no more: ${error.message}. Orders from here are given without it.`),
      element("button", { type: "button", onclick: () => { banner.hidden = true; } }, "Seen"));
    observatory.soon("lease", 0);
    show();
  }

  /** A sign of life for each telescope that this tab holds; how long until the next one. */
  async function beat() {
    let all = true;
    for (const { id } of observatory.telescopes) {
      const secret = kept.get(id);
      if (!secret) continue;
      try {
        const told = await leaseCall("PUT", id);
        if (id !== observatory.id) continue;
        observatory.lease = { ...told, heard_ms: Date.now() };
        observatory.tell("lease");
      } catch (error) {
        if (error instanceof Refused && error.status === 409) lost(id, secret, error);
        else all = false;
      }
    }
    return all ? BEAT_MS : AGAIN_MS;
  }

  take.addEventListener("click", () => open(terms.hidden));
  release.addEventListener("click", given);
  terms.addEventListener("submit", taken);
  terms.addEventListener("keydown", (event) => {
    if (event.key === "Escape") open(false, true);
  });
  by("control-no").addEventListener("click", () => open(false, true));
  for (const topic of ["lease", "telescope", "capabilities", "link", "sky"]) observatory.on(topic, show);
  observatory.on("telescope", () => open(false));
  observatory.on("lease-lost", lost);
  observatory.on("telescopes", () => wake());
  observatory.on("link", () => {
    if (observatory.lostSince === null) wake();
  });
  // whoever broke it, or let it run out: the next sign of life learns it
  observatory.on("event", (kind) => {
    if (kind.startsWith("lease-") && mine()) wake();
  });
  document.addEventListener("visibilitychange", () => wake());
  // what another does with it is told by events, and asked now and then in case one was missed
  setInterval(() => {
    if (!document.hidden && observatory.id && observatory.lostSince === null && (key.get() || observatory.state)) observatory.soon("lease", 0);
  }, BEAT_MS);
  (async () => {
    for (;;) {
      const pause = await beat();
      await new Promise((done) => {
        wake = done;
        setTimeout(done, pause);
      });
    }
  })();
  show();
}
