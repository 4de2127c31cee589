// The journal, newest first, filtered by kind and words; older lines on demand.

import { get, Refused } from "./calls.js";
import { by, element, fill } from "./elements.js";
import { clockOf, placesIn } from "./angles.js";

const PAGE = 40;
const TYPING_MS = 300;
const NEWS_MS = 1000;
const TROUBLE = ["fault", "refusal", "link"];

export function showJournal(observatory) {
  const scroller = by("journal-lines").closest(".scroll");
  let cursor = null, newest = "", asked = 0, waiting = null, lines = [];

  function query(from) {
    const kind = document.querySelector("input[name=jk]:checked").value;
    const text = by("journal-text").value.trim();
    const query = new URLSearchParams({ newest_first: "true", limit: String(PAGE) });
    if (observatory.id) query.set("telescope", observatory.id);
    if (kind === "trouble") TROUBLE.forEach((one) => query.append("kind", one));
    else if (kind) query.append("kind", kind);
    if (text) query.set("text", text);
    if (from) query.set("cursor", from);
    return `/v1/journal?${query}`;
  }

  async function read(more = false) {
    const mine = ++asked;
    let page;
    try {
      page = await get(query(more ? cursor : null));
    } catch (error) {
      if (mine === asked && error instanceof Refused) {
        newest = "";
        if (![401, 403].includes(error.status)) observatory.note("journal", error);
      }
      return;
    }
    if (mine !== asked) return;
    observatory.note("journal");
    const mark = page.lines.map((one) => one.utc + one.words).join();
    if (!more && mark === newest) return;
    if (!more) newest = mark;
    if (more) [lines, cursor] = [[...lines, ...page.lines], page.next_cursor];
    else renew(page);
    by("journal-more").hidden = !cursor;
    const before = scroller.scrollHeight, from = scroller.scrollTop;
    show();
    if (!more && from > 0) scroller.scrollTop = from + scroller.scrollHeight - before;
  }

  /** News above; who reads further down keeps the lines there, as far as they hang together with the news. */
  function renew(page) {
    const oldest = page.lines.at(-1)?.utc;
    const hangs = page.lines.length && lines.length && lines[0].utc >= oldest;
    const older = scroller.scrollTop > 0 && hangs ? lines.filter((one) => one.utc < oldest) : [];
    if (!older.length) cursor = page.next_cursor;
    lines = [...page.lines, ...older];
  }

  function show() {
    let day = "";
    const items = [];
    for (const one of lines) {
      const date = one.utc.slice(0, 10);
      if (date !== day) items.push(element("li", { class: "day" }, date));
      day = date;
      const trouble = TROUBLE.includes(one.kind) || one.facts?.solved === false || ["refused", "unknown", "refused but done", "ignored", "elsewhere", "stalled", "not sent"].includes(one.facts?.outcome);
      const well = one.kind === "link" && one.words.startsWith("connected");
      items.push(element("li", { class: [trouble ? "trouble" : "", well ? "well" : ""].join(" ").trim() },
        element("time", { datetime: one.utc }, clockOf(one.utc)), element("span", { class: "kind" }, one.kind), element("span", { class: "what" }, placesIn(one.words))));
    }
    fill(by("journal-lines"), ...(items.length ? items : [element("li", { class: "day" }, "nothing of that kind")]));
  }

  /** Another filter, another telescope: nothing of the old list belongs to the new one. */
  function anew(ms = 0) {
    [newest, lines] = ["", []];
    scroller.scrollTop = 0;
    again(ms);
  }
  function again(ms = 0) {
    clearTimeout(waiting);
    waiting = setTimeout(() => read(), ms);
  }
  by("journal-filter").addEventListener("submit", (event) => event.preventDefault());
  by("journal-filter").addEventListener("change", () => anew());
  by("journal-text").addEventListener("input", () => anew(TYPING_MS));
  by("journal-more").addEventListener("click", () => read(true));
  observatory.on("journal", () => again(NEWS_MS));
  observatory.on("telescope", () => {
    fill(by("journal-lines")); // another telescope's lines are not this one's
    anew();
  });
}
