// What the doctors say, and how the night stands.

import { get } from "./calls.js";
import { by, element, fill, say } from "./elements.js";

const EVERY_MS = 60_000;
const NOT_READY_MS = 5000;

export function showDoctors(observatory) {
  let pointing = null, drift = null, catalogs = null, asked = 0, last = 0;

  async function ask() {
    if (!observatory.id) return;
    const mine = ++asked, id = observatory.id;
    last = performance.now();
    const [found, drifts] = await Promise.allSettled([get(observatory.path("pointing-doctor")), get(observatory.path("drift"))]);
    if (mine !== asked || id !== observatory.id) return;
    pointing = found.value ?? null;
    drift = drifts.value ?? null;
    say(by("drift-words"), drift?.words ?? "");
    show();
  }

  function show() {
    const parts = [];
    if (pointing) {
      parts.push(said("Pointing", pointing.words));
      for (const one of [...pointing.findings, ...pointing.suspicions]) {
        parts.push(element("p", { class: "found" }, element("b", {}, `${one.what}, probability ${Number(one.probability).toFixed(2)}`), one.words, element("br"), one.advice ?? ""));
      }
    }
    if (drift?.polar?.advice) parts.push(said("Polar axis", drift.polar.advice));
    else if (drift?.polar_reason) parts.push(said("Polar axis", drift.polar_reason));
    if (catalogs) {
      const told = catalogs.catalogs;
      parts.push(said("Catalogs", `${told.verdict}${told.fails_percent === null ? "" : `: ${told.fails_percent} % of the reachable fields would not be solved`}`));
      for (const one of told.advice) parts.push(element("p", {}, one));
      if (told.camera.problem) parts.push(element("p", { class: "warn-text" }, told.camera.problem));
    }
    const { health } = observatory;
    for (const one of [...(health?.why_not ?? []), ...(health?.concerns ?? [])]) parts.push(element("p", { class: "found" }, element("b", {}, "Service"), one));
    if (health?.earth_rotation?.warning) parts.push(said("Earth rotation", health.earth_rotation.warning));
    if (health?.journal && health.journal !== "ok") parts.push(said("Journal", health.journal));
    if (health && health.solver?.startsWith("failed")) parts.push(said("Solver", health.solver));
    fill(by("doctor-words"), ...(parts.length ? parts : [element("p", { class: "dim" }, "nothing to say yet")]));
  }
  const said = (who, words) => element("p", {}, element("b", {}, who), words);

  const button = by("doctor-catalog");
  button.addEventListener("click", async () => {
    const { id } = observatory;
    button.disabled = true;
    say(button, "Counting stars …");
    try {
      const told = await get(observatory.path("doctor"));
      // words about one telescope never stand under another
      if (id === observatory.id) {
        catalogs = told;
        show();
      }
    } catch (error) {
      if (id === observatory.id) fill(by("doctor-words"), element("p", { class: "bad-text" }, error.message));
    }
    button.disabled = false;
    say(button, "Ask the catalog doctor");
  });

  observatory.on("telescope", () => {
    [pointing, drift, catalogs] = [null, null, null];
    ask();
  });
  observatory.on("health", () => {
    show();
    if (observatory.health?.ready === false && !document.hidden) observatory.soon("health", NOT_READY_MS);
  });
  observatory.on("offsets", () => {
    if (performance.now() - last > 5000) ask();
  });
  setInterval(() => {
    if (document.hidden || observatory.lostSince !== null) return;
    ask();
    observatory.soon("health", 0);
  }, EVERY_MS);

  observatory.on("night", () => {
    const night = observatory.night;
    const cell = (name, text) => [element("dt", {}, name), element("dd", { class: "live" }, text)];
    if (!night) {
      fill(by("night-list"), element("dt", {}, night === null ? "This telescope has no nights (night.enabled)." : "–"));
      return;
    }
    fill(by("night-list"), ...cell("Phase", night.phase), ...cell("Holds", night.holds.join(", ") || "none"),
      ...cell("Frames", `${night.placed} of ${night.frames} placed`), ...cell("Corrections", `${night.corrections} by ${night.correct_by}`),
      ...(night.last ? cell("Last", night.last.act) : []), ...(night.unsafe_why ? cell("Unsafe", night.unsafe_why) : []),
      ...(night.folder_problem ? cell("Folder", night.folder_problem) : []));
  });
}
