// Sound and notification for trouble: off until somebody turns them on, kept by this browser, silent when it is over.

import { by, say } from "./elements.js";
import { stateWords } from "./state_line.js";

const SOUND = "mountnav-sound", NOTIFY = "mountnav-notify";
const AGAIN_MS = 60_000; // it sounds again while the trouble lasts
const CALM_MS = 3000; // a trouble that is over sooner is none

const kept = {
  get: (name) => {
    try {
      return localStorage.getItem(name) === "1";
    } catch {
      return false;
    }
  },
  set: (name, on) => {
    try {
      localStorage.setItem(name, on ? "1" : "");
    } catch { /* a browser that keeps nothing */ }
  },
};

/** What is wrong now, by telescope: {id: words}. The connection stands under "". */
export function troublesOf(observatory) {
  const found = {};
  if (observatory.lostSince !== null) return { "": "the page has no connection to the service" };
  const states = new Map(observatory.fleet.map((one) => [one.id, one]));
  if (observatory.state) states.set(observatory.state.id, observatory.state);
  for (const [id, state] of states) {
    const { word, tone, detail } = stateWords(state, null);
    if (tone === "bad") found[id] = detail ? `${word}: ${detail}` : word;
  }
  return found;
}

export function takeAlerts(observatory) {
  const opener = by("alerts-open"), row = by("alerts"), sound = by("alert-sound"), notify = by("alert-notify");
  const since = new Map(), told = new Map();
  let audio = null;

  const wants = { sound: kept.get(SOUND), notify: kept.get(NOTIFY) };
  // three telescopes' states are read for it as well
  const may = () => "Notification" in window && window.isSecureContext;

  function show(words) {
    sound.setAttribute("aria-pressed", String(wants.sound));
    notify.setAttribute("aria-pressed", String(wants.notify));
    notify.disabled = !may();
    const waits = wants.sound && (audio === null || audio.state !== "running");
    const parts = [words ?? (wants.sound || wants.notify ? "On" : "Both off") + ". For trouble at any telescope, and a lost connection."];
    if (!may()) parts.push("Notifications need https or this computer's own address.");
    if (waits) parts.push("The browser lets it sound after a click on the page.");
    say(by("alerts-told"), parts.join(" "));
    say(opener, wants.sound || wants.notify ? "Alerts on" : "Alerts");
  }

  function ready() {
    if (!wants.sound) return;
    audio ??= new AudioContext();
    audio.resume().then(() => show(), () => {});
  }

  /** Two tones, three times: heard over a fan, and no alarm clock. */
  function ring() {
    if (!audio || audio.state !== "running") return;
    for (let i = 0; i < 6; i++) {
      const tone = audio.createOscillator(), loud = audio.createGain(), at = audio.currentTime + 0.22 * i;
      tone.frequency.value = i % 2 ? 620 : 880;
      loud.gain.setValueAtTime(0, at);
      loud.gain.linearRampToValueAtTime(0.25, at + 0.02);
      loud.gain.linearRampToValueAtTime(0, at + 0.2);
      tone.connect(loud).connect(audio.destination);
      tone.start(at);
      tone.stop(at + 0.21);
    }
  }

  function judge() {
    const now = Date.now(), troubles = troublesOf(observatory);
    for (const id of since.keys()) {
      if (id in troubles) continue;
      since.delete(id);
      told.delete(id);
    }
    let news = null;
    for (const [id, words] of Object.entries(troubles)) {
      if (!since.has(id)) since.set(id, now);
      if (now - since.get(id) < CALM_MS || now - (told.get(id) ?? -AGAIN_MS) < AGAIN_MS) continue;
      if (wants.notify && !told.has(id) && may() && Notification.permission === "granted") {
        new Notification(id ? `Trouble: ${id}` : "mountnav", { body: words, tag: `mountnav ${id}` });
      }
      told.set(id, now);
      news = words;
    }
    if (news !== null && wants.sound) ring();
    if (news !== null) row.dataset.last = news;
  }

  opener.addEventListener("click", () => {
    row.hidden = !row.hidden;
    opener.setAttribute("aria-expanded", String(!row.hidden));
    show();
  });
  sound.addEventListener("click", () => {
    wants.sound = !wants.sound;
    kept.set(SOUND, wants.sound);
    ready();
    show();
    if (wants.sound) audio.resume().then(ring, () => {});
  });
  notify.addEventListener("click", async () => {
    wants.notify = !wants.notify;
    if (wants.notify && await Notification.requestPermission() !== "granted") {
      wants.notify = false;
      kept.set(NOTIFY, false);
      show("The browser does not allow notifications of this page.");
      return;
    }
    kept.set(NOTIFY, wants.notify);
    show();
  });
  document.addEventListener("pointerdown", ready, { once: true });
  for (const topic of ["state", "fleet", "link"]) observatory.on(topic, judge);
  setInterval(judge, 1000);
  show();
}
