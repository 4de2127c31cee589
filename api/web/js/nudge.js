// Nudges: so much on the sky, north, south, east or west; one slew each, within the limits.

import { by } from "./elements.js";

const SIDES = { north: [0, 1], south: [0, -1], east: [1, 0], west: [-1, 0] };

export function takeNudges(observatory, give) {
  const buttons = document.querySelectorAll("[data-nudge]");
  for (const button of buttons) {
    const [east, north] = SIDES[button.dataset.nudge];
    button.addEventListener("click", () => {
      const list = by("nudge-by"), by_arcsec = Number(list.value);
      give({ kind: "offset", east_arcsec: east * by_arcsec, north_arcsec: north * by_arcsec },
        `nudge ${list.selectedOptions[0].textContent} ${button.dataset.nudge}`);
    });
  }
  function enable() {
    const up = Boolean(observatory.state?.connected) && observatory.lostSince === null && observatory.capabilities?.your_role !== "view";
    for (const button of buttons) button.disabled = !up;
  }
  for (const topic of ["state", "link", "capabilities"]) observatory.on(topic, enable);
  enable();
}
