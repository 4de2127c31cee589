// The page, put together: one observatory, its panels, the key, night mode.

import { isPlain, key } from "./calls.js";
import { by, redraw, say } from "./elements.js";
import { Observatory } from "./observatory.js";
import { takeAlerts } from "./alerts.js";
import { showAttempts } from "./attempts.js";
import { showBullseye } from "./bullseye.js";
import { showDoctors } from "./doctors.js";
import { takeFiles } from "./file.js";
import { showFleet } from "./fleet.js";
import { showFrame } from "./frame_map.js";
import { showHeadline } from "./headline.js";
import { showJournal } from "./journal.js";
import { showJob } from "./job.js";
import { showControl } from "./lease.js";
import { showFollowing } from "./moving.js";
import { takeOrders } from "./orders.js";
import { takePad } from "./pad.js";
import { showPanelStates } from "./panel_states.js";
import { takeParts } from "./parts.js";
import { showPlace } from "./place.js";
import { showPlots } from "./plots.js";
import { takeAnswers } from "./question.js";
import { showSkyMap } from "./sky_map.js";
import { showStateLine } from "./state_line.js";
import { takeStop } from "./stop.js";
import { showStrip } from "./strip.js";

const NIGHT = "mountnav-night";

const observatory = new Observatory();
takeStop(observatory); // before all else
takeParts();
showStateLine(observatory);
showHeadline(observatory);
showPlace(observatory);
showSkyMap(observatory);
showFollowing(observatory);
takeOrders(observatory);
takePad(observatory);
takeAnswers(observatory);
showControl(observatory);
showJob(observatory);
showBullseye(observatory);
showStrip(observatory);
showFrame(observatory);
showAttempts(observatory);
const redrawPlots = showPlots(observatory);
showJournal(observatory);
showDoctors(observatory);
takeFiles();
showFleet(observatory);
takeAlerts(observatory);
showPanelStates(observatory);
takeKey();
nightMode();
aboveTheKeyboard();
tellOfUpdates();
observatory.start();

function takeKey() {
  const row = by("key-row"), opener = by("key-open");
  const open = (yes) => {
    row.hidden = !yes;
    opener.setAttribute("aria-expanded", String(yes));
  };
  opener.addEventListener("click", () => open(row.hidden));
  by("key-form").addEventListener("submit", (event) => {
    event.preventDefault();
    const typed = by("key").value.trim();
    if (!isPlain(typed)) {
      const notice = by("notice");
      notice.className = "banner bad";
      notice.hidden = false;
      say(notice, "That is no key: a key has plain letters, digits and signs only. Is the keyboard set to another language?");
      by("key").select();
      return;
    }
    key.use(typed);
    by("key").value = "";
    by("notice").hidden = true;
    open(false);
    observatory.keyChanged();
  });
  by("key-forget").addEventListener("click", () => {
    key.forget();
    observatory.keyChanged();
  });
  let refused = null;
  observatory.on("key", (error) => {
    const notice = by("notice");
    notice.className = "banner bad";
    notice.hidden = false;
    say(notice, error.message);
    // once for each key that was refused: whoever closed the row may go on in peace
    if (row.hidden && error.status === 401 && refused !== (key.get() ?? "")) {
      open(true);
      by("key").focus();
    }
    refused = key.get() ?? "";
  });
  for (const topic of ["telescopes", "state"]) {
    observatory.on(topic, () => {
      if (!observatory.state && topic === "state") return;
      refused = null;
      by("notice").hidden = true;
    });
  }
}

/** STOP stays above a keyboard on the glass, and in sight while the page is pinched larger. */
function aboveTheKeyboard() {
  const seen = window.visualViewport;
  if (!seen) return;
  const set = () => {
    const covered = Math.max(0, document.documentElement.clientHeight - seen.height - seen.offsetTop);
    const { style } = document.documentElement;
    style.setProperty("--covered", `${Math.round(covered)}px`);
    style.setProperty("--seen-left", `${Math.round(seen.offsetLeft)}px`);
    style.setProperty("--seen-width", `${Math.round(seen.width)}px`);
  };
  for (const event of ["resize", "scroll"]) seen.addEventListener(event, set);
  set();
}

/** A service that was updated under an open page is told: nobody steers with yesterday's page. */
function tellOfUpdates() {
  let first = null;
  observatory.on("health", () => {
    const version = observatory.health?.version;
    if (!version) return;
    first ??= version;
    by("updated").hidden = version === first;
    say(by("updated-words"), `The service is now mountnav ${version}, this page is of ${first}.`);
  });
  by("reload").addEventListener("click", () => location.reload());
}

function nightMode() {
  const button = by("night-mode"), root = document.documentElement;
  const set = (on) => {
    if (on) root.dataset.night = "";
    else delete root.dataset.night;
    button.setAttribute("aria-pressed", String(on));
    document.querySelector("meta[name=theme-color]").content = on ? "#000000" : "#080b0f";
    try {
      localStorage.setItem(NIGHT, on ? "1" : "");
    } catch { /* a browser that keeps nothing */ }
    redraw();
    redrawPlots();
  };
  button.addEventListener("click", () => set(root.dataset.night === undefined));
  if (root.dataset.night !== undefined) set(true); // first.js has read what was kept
}
