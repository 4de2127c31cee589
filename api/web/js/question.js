// The one question before what destroys, or moves more than was seen: asked in the page, answered once.

import { by, say } from "./elements.js";
import { showPart } from "./parts.js";

let asking = null;

/** Ask, with the focus on Yes; `go` is called on Yes, and the focus goes back to the button that led here. */
export function askOnce(words, opener, go, yes = "Yes", no = "No") {
  asking = { opener, go };
  say(by("ask-words"), words);
  say(by("ask-yes"), yes);
  say(by("ask-no"), no);
  showPart("orders"); // on a phone it stands there
  by("ask").hidden = false;
  by("ask-yes").focus();
}

/** Take the question back. */
export function unask(toFocus = false) {
  if (!asking) return;
  const { opener } = asking;
  asking = null;
  by("ask").hidden = true;
  if (toFocus) opener?.focus();
}

export function takeAnswers(observatory) {
  by("ask-yes").addEventListener("click", () => {
    const go = asking?.go;
    unask(true);
    go?.();
  });
  by("ask-no").addEventListener("click", () => unask(true));
  by("ask").addEventListener("keydown", (event) => {
    // the key that opened the question, still held down, is no answer
    if (event.repeat && ["Enter", " "].includes(event.key)) event.preventDefault();
    if (event.key === "Escape") unask(true);
  });
  // what was asked about another telescope, or a state that isn't known any more, is asked anew
  observatory.on("telescope", () => unask());
  observatory.on("link", () => {
    if (observatory.lostSince !== null) unask();
  });
}
