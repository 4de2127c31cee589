// On a phone the page has four parts; the one that is shown is remembered. A question is asked where its button stands.

import { by, redraw } from "./elements.js";

const KEPT = "mountnav-part";

export function showPart(part) {
  if (document.body.dataset.part === part) return;
  document.body.dataset.part = part;
  for (const one of by("tabs").children) one.setAttribute("aria-pressed", String(one.dataset.part === part));
  window.scrollTo(0, 0);
  redraw();
}

export function takeParts() {
  let kept = null;
  try {
    kept = sessionStorage.getItem(KEPT);
  } catch { /* a browser that keeps nothing */ }
  for (const button of by("tabs").children) {
    button.addEventListener("click", () => {
      showPart(button.dataset.part);
      try {
        sessionStorage.setItem(KEPT, button.dataset.part);
      } catch { /* as above */ }
    });
  }
  if (kept && by("tabs").querySelector(`[data-part="${kept}"]`)) showPart(kept);
}
