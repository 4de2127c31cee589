// A file dropped on the page, or chosen, is sent to be solved; nothing moves by it.

import { solveFile } from "./calls.js";
import { by, element, fill } from "./elements.js";
import { dms, hms } from "./angles.js";

export function takeFiles() {
  const over = by("dropping");
  let depth = 0, turn = 0;

  const hasFile = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  document.addEventListener("dragenter", (event) => {
    if (!hasFile(event)) return;
    depth++;
    over.hidden = false;
  });
  document.addEventListener("dragleave", (event) => {
    if (hasFile(event) && --depth <= 0) over.hidden = true;
  });
  document.addEventListener("dragover", (event) => {
    if (hasFile(event)) event.preventDefault();
  });
  document.addEventListener("drop", (event) => {
    if (!hasFile(event)) return;
    event.preventDefault();
    depth = 0;
    over.hidden = true;
    if (event.dataTransfer.files[0]) solve(event.dataTransfer.files[0]);
  });
  by("drop-file").addEventListener("change", () => {
    const [file] = by("drop-file").files;
    if (file) solve(file);
    by("drop-file").value = ""; // the same file may be chosen again
  });

  async function solve(file) {
    const told = by("solve-told"), mine = ++turn;
    by("solve").scrollIntoView({ block: "nearest" });
    fill(told, element("span", { class: "warn-text" }, `${file.name}: solving …`));
    try {
      const found = await solveFile(file);
      if (mine !== turn) return; // another was dropped meanwhile
      if (!found.solved) {
        fill(told, element("span", { class: "bad-text" }, `${file.name}: not solved. ${found.reason}`));
        return;
      }
      const row = (name, text) => [element("dt", {}, name), element("dd", {}, text)];
      fill(told, element("span", { class: "good-text" }, `${file.name}: solved`), element("dl", {},
        ...row("RA ICRS", hms(found.ra_deg, 2)), ...row("Dec ICRS", dms(found.dec_deg, 1)), ...row("Scale", `${found.scale_arcsec_px.toFixed(4)}″/px`),
        ...row("+y turned", `${found.rotation_deg.toFixed(2)}°${found.parity < 0 ? ", mirrored" : ""}`),
        ...row("Stars", `${found.pairs}, rms ${found.rms_arcsec.toFixed(2)}″`), ...row("By", `${found.mode}, ${found.time_s.total.toFixed(2)} s`)),
        element("button", { type: "button", onclick: () => {
          by("target").value = `${found.ra_deg.toFixed(5)} ${found.dec_deg < 0 ? "" : "+"}${found.dec_deg.toFixed(5)}`;
          by("target").dispatchEvent(new Event("input"));
          by("target").focus();
        } }, "Take as target"));
    } catch (error) {
      if (mine !== turn) return;
      fill(told, element("span", { class: "bad-text" }, `${file.name}: ${error.message}`));
    }
  }
}
