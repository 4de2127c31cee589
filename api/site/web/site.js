// The page of a site: draws what GET /v1/site tells, and gives STOP ALL. It knows no other order.

const byId = (id) => document.getElementById(id);
const POLL_MS = 2000; // between two questions; the services are asked by the page's own server
const PATIENCE_MS = 5000; // for an answer of that server
const LOST_AFTER_MS = 6000; // without one: what stands here is old
const STATES = { waiting: "not asked yet", ok: "well", degraded: "look into it", silent: "no answer", refused: "key refused", strange: "strange answer" };

let key = null;
try {
  key = sessionStorage.getItem("mountnav-site-key");
} catch {
  // a browser that keeps nothing
}
let answeredAt = performance.now();
let clockOffset = null;

const headers = () => (key ? { "X-API-Key": key } : {});

async function ask(method, path) {
  const answer = await fetch(path, { method, headers: headers(), signal: AbortSignal.timeout(PATIENCE_MS), cache: "no-store" });
  const told = await answer.json();
  return { status: answer.status, told };
}

function element(tag, text, className) {
  const made = document.createElement(tag);
  if (text !== undefined && text !== null) made.textContent = text;
  if (className) made.className = className;
  return made;
}

const sexagesimal = (value, width) => {
  const minutes = Math.round(Math.abs(value) * 60);
  return `${String(Math.floor(minutes / 60)).padStart(width, "0")}:${String(minutes % 60).padStart(2, "0")}`;
};
const place = (one) => {
  if (one.ra_deg === null || one.dec_deg === null) return "";
  return `${sexagesimal((one.ra_deg / 15) % 24, 2)} ${one.dec_deg < 0 ? "−" : "+"}${sexagesimal(one.dec_deg, 2)}`;
};

function telescopeRow(one) {
  const row = element("tr");
  const name = element("th", one.id);
  name.scope = "row";
  const doing = element("td", one.connected === false ? "not connected" : one.activity ?? "unknown");
  for (const words of [one.problem, ...one.warnings]) if (words) doing.append(element("small", words));
  const altitude = one.altitude_deg === null ? "" : `${one.altitude_deg.toFixed(0)}° high`;
  const where = element("td", null, "place num");
  where.append(element("div", place(one)), element("div", altitude));
  row.append(name, doing, where);
  return row;
}

function stopWords(stop) {
  const word = stop.stopped === true ? "stopped" : stop.stopped === false ? "NOT STOPPED" : "NOT KNOWN whether it stopped";
  if (!stop.problem) return word;
  // the problem itself may begin with it
  const problem = stop.problem.replace(/^not known/, "NOT KNOWN");
  return problem.startsWith("NOT ") ? problem : `${word}: ${problem}`;
}

function tile(one) {
  const made = element("section", null, one.state === "ok" || one.state === "degraded" ? "service" : "service stale");
  made.dataset.state = one.state;
  made.dataset.name = one.name;
  const title = element("h2", one.name);
  title.append(element("span", STATES[one.state] ?? one.state, "state"));
  const from = element("div", null, "from");
  const link = element("a", one.url.replace(/^https?:\/\//, ""));
  link.href = one.url;
  link.rel = "noreferrer";
  const age = one.age_s === null ? "never answered" : one.age_s < 10 ? "just now" : `${Math.round(one.age_s)} s ago`;
  from.append(link, ` · ${age}${one.version ? ` · ${one.version}` : ""}`);
  made.append(title, from);
  if (one.problem) made.append(element("p", one.problem, "trouble"));
  if (one.stop) made.append(element("p", `${one.stop.given_utc.slice(11, 19)} STOP ALL: ${stopWords(one.stop)}`, "stop-row"));
  if (one.concerns.length) {
    const list = element("ul", null, "concerns");
    for (const words of one.concerns) list.append(element("li", words));
    made.append(list);
  }
  if (one.telescopes.length) {
    const table = element("table");
    const body = element("tbody");
    body.append(...one.telescopes.map(telescopeRow));
    table.append(body);
    made.append(table);
  }
  return made;
}

function draw(site) {
  clockOffset = Date.parse(site.utc) - performance.now();
  const telescopes = site.services.flatMap((one) => one.telescopes);
  const wrong = site.services.filter((one) => one.state !== "ok" && one.state !== "waiting");
  const summary = byId("summary");
  const words = wrong.length ? `to look into: ${wrong.map((one) => one.name).join(", ")}` : "all well";
  const text = `${site.services.length} services, ${telescopes.length} telescopes · ${words}`;
  if (summary.textContent !== text) summary.textContent = text;
  byId("services").replaceChildren(...site.services.map(tile));
  byId("stop-all").disabled = !site.may_stop;
}

function lost(words) {
  const banner = byId("lost");
  banner.hidden = words === null;
  if (words !== null && banner.textContent !== words) banner.textContent = words;
}

async function poll() {
  try {
    const { status, told } = await ask("GET", "/v1/site");
    if (status === 200) {
      answeredAt = performance.now();
      lost(null);
      draw(told);
    } else {
      if (status === 401) openKey(true);
      lost(`This page is not let in: ${told.detail ?? status}`);
    }
  } catch {
    if (performance.now() - answeredAt > LOST_AFTER_MS) {
      lost("NO CONNECTION to the page's server: what stands here is old, and STOP ALL may not get through. Use the telescopes' own pages.");
    }
  }
  setTimeout(poll, POLL_MS);
}

let stopping = 0;
async function stopAll() {
  const told = byId("stop-told");
  const mine = (stopping += 1);
  const show = (tone, words, lines = []) => {
    if (mine !== stopping) return;
    told.className = `banner ${tone}`;
    told.replaceChildren(element("strong", words));
    if (lines.length) {
      const list = element("ul");
      list.append(...lines.map((line) => element("li", line)));
      told.append(list);
    }
    told.hidden = false;
  };
  show("warn", "STOP ALL was given …");
  try {
    const { told: site } = await ask("POST", "/v1/stop");
    if (!site.services) {
      show("bad", `STOP ALL was NOT given: ${site.detail ?? "no answer of a site"}`);
      return;
    }
    const bad = site.services.filter((one) => one.stopped !== true);
    const well = site.services.length - bad.length;
    if (bad.length) show("bad", `${well} of ${site.services.length} services stopped; look at the others now:`, bad.map((one) => `${one.name}: ${stopWords(one)}`));
    else show("good", `All ${well} services stopped.`);
  } catch {
    show("bad", "NOT KNOWN whether STOP ALL got through: this page's server doesn't answer. Use the telescopes' own pages.");
  }
}

function openKey(open) {
  byId("key-row").hidden = !open;
  byId("key-open").setAttribute("aria-expanded", String(open));
}

byId("stop-all").addEventListener("click", stopAll);
byId("key-open").addEventListener("click", () => {
  openKey(byId("key-row").hidden);
  if (!byId("key-row").hidden) byId("key").focus();
});
byId("key-row").addEventListener("submit", (event) => {
  event.preventDefault();
  remember(byId("key").value.trim() || null);
  byId("key").value = "";
  openKey(false);
});
byId("key-forget").addEventListener("click", () => remember(null));
function remember(value) {
  key = value;
  try {
    if (key) sessionStorage.setItem("mountnav-site-key", key);
    else sessionStorage.removeItem("mountnav-site-key");
  } catch {
    // it is kept as long as the page is open
  }
}

let escapedAt = -Infinity;
document.addEventListener("keydown", (event) => {
  if (event.key !== "Escape" || event.repeat) return;
  const button = byId("stop-all");
  if (performance.now() - escapedAt < 600) {
    button.classList.remove("armed");
    escapedAt = -Infinity;
    if (!button.disabled) stopAll();
    return;
  }
  escapedAt = performance.now();
  button.classList.add("armed");
  setTimeout(() => button.classList.remove("armed"), 600);
});

const night = byId("night-mode");
const drawNight = () => night.setAttribute("aria-pressed", String("night" in document.documentElement.dataset));
night.addEventListener("click", () => {
  const on = !("night" in document.documentElement.dataset);
  if (on) document.documentElement.dataset.night = "";
  else delete document.documentElement.dataset.night;
  try {
    if (on) localStorage.setItem("mountnav-night", "1");
    else localStorage.removeItem("mountnav-night");
  } catch {
    // it lasts as long as the page is open
  }
  drawNight();
});
drawNight();

setInterval(() => {
  if (clockOffset !== null) byId("clock-time").textContent = new Date(clockOffset + performance.now()).toISOString().slice(11, 19);
}, 500);
poll();
