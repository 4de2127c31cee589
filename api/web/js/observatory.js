// What is known of the telescope that is shown, when it was learned, and who wants to be told of news.

import { AnotherKey, get, getIfNew, key, NoConnection, Refused } from "./calls.js";
import { follow } from "./stream.js";

const STATE_MS = 1000;
const HIDDEN_MS = 5000;
const OLD_MS = 3500;
const SOON_MS = 250;
const AGAIN_MS = 10_000;
const JOBS = 25;
const TONIGHT_MS = 60_000;

/** Topics: telescopes, telescope, state, sky, limits, job, jobs, lease, lease-lost, frame, offsets, night, journal, health, link, event, key, fleet, tonight, heard. */
export class Observatory {
  telescopes = [];
  id = null;
  state = null;
  sky = null;
  limits = null;
  jobs = [];
  job = null;
  frame = null;
  offsets = null;
  night = undefined;
  health = null;
  capabilities = null;
  lease = null;
  lookTimes = new Map();
  asked = null;
  lostSince = null;
  /** The same by the service's clock, which may be a virtual night's. */
  lostUtc = null;
  /** The last state of each telescope, where there are several. */
  fleet = [];
  tonight = null;
  /** What was read of this telescope, and why something could not be. */
  heard = new Set();
  faults = new Map();
  #clock = null;
  #known = null;
  #told = new Map();
  #fresh = null;
  #soon = new Map();
  #stream = null;
  #shut = false;
  #wake = () => {};

  on(topic, listener) {
    if (!this.#told.has(topic)) this.#told.set(topic, []);
    this.#told.get(topic).push(listener);
  }

  tell(topic, ...values) {
    for (const listener of this.#told.get(topic) ?? []) listener(...values);
  }

  path(rest = "") {
    return `/v1/telescopes/${encodeURIComponent(this.id)}${rest ? `/${rest}` : ""}`;
  }

  /** Begin: nothing else has to be called. */
  async start() {
    this.#stream = follow("/v1/events", (kind, data) => this.#heard(kind, data), (up) => this.#link(up));
    setInterval(() => this.#judgeAge(), 250);
    setInterval(() => {
      if (!document.hidden && this.id && this.lostSince === null) this.soon("tonight", 0);
    }, TONIGHT_MS);
    document.addEventListener("visibilitychange", () => {
      // a browser has six connections to one place for all of its tabs: one that nobody sees holds none
      this.#stream.pause(document.hidden);
      this.#judgeAge();
      this.#wake();
    });
    for (;;) {
      await this.#poll();
      await new Promise((done) => {
        this.#wake = done;
        setTimeout(done, document.hidden || this.#shut ? HIDDEN_MS : STATE_MS);
      });
    }
  }

  /** Now by the service's clock, ms; null before it was heard. A virtual night's clock runs faster. */
  now() {
    if (this.#clock === null) return null;
    return this.#clock.service + (performance.now() - this.#clock.ticks) * (this.health?.virtual?.speed ?? 1);
  }

  /** How long ago an instant of the service's clock was, in seconds of ours. */
  ageOf(utc) {
    const now = this.now();
    return utc && now !== null ? Math.max(0, (now - Date.parse(utc)) / 1000 / (this.health?.virtual?.speed ?? 1)) : null;
  }

  /** How old the last reading of the mount is, s. */
  readAge() {
    return this.ageOf(this.state?.read_utc);
  }

  /** Something was read, or could not be. */
  note(what, error = null) {
    if (error === null) {
      this.heard.add(what);
      this.faults.delete(what);
    } else this.faults.set(what, error);
    this.tell("heard");
  }

  /** Let go of the stream's connection: something more urgent needs one. */
  quiet() {
    this.#stream?.drop();
  }

  /** What the telescope that is shown can do, as far as it is known. */
  get can() {
    return this.capabilities?.telescopes.find((one) => one.id === this.id);
  }

  /** Show another telescope. */
  choose(id) {
    if (id === this.id) return;
    Object.assign(this, {
      id, state: null, sky: null, limits: null, job: null, jobs: [], frame: null, offsets: null, night: undefined, asked: null, lease: null, tonight: null,
    });
    for (const what of [...this.heard]) if (!["health", "capabilities"].includes(what)) this.heard.delete(what);
    this.faults.clear();
    this.#known = null;
    this.#fresh = null;
    try {
      localStorage.setItem("mountnav-telescope", id);
    } catch { /* a browser that keeps nothing */ }
    for (const topic of ["telescope", "state", "sky", "limits", "job", "jobs", "frame", "offsets", "night", "lease", "tonight", "heard"]) this.tell(topic);
    this.#poll();
    this.everything();
  }

  /** Read all that changes seldom. */
  everything() {
    for (const what of ["capabilities", "limits", "jobs", "frame", "offsets", "lease", "health", "tonight"]) this.soon(what, 0);
    this.tell("journal");
  }

  /** The key has changed: begin anew with it. */
  keyChanged() {
    this.#stream?.again();
    this.telescopes = [];
    this.#poll().then(() => this.#wake());
  }

  /** Read something again in a moment; many calls become one. */
  soon(what, ms = SOON_MS) {
    if (this.#soon.has(what)) return;
    this.#soon.set(what, setTimeout(() => {
      this.#soon.delete(what);
      this.#read(what);
    }, ms));
  }

  async #poll() {
    try {
      if (!this.telescopes.length) {
        this.telescopes = await get("/v1/telescopes");
        this.#heardFrom();
        this.tell("telescopes");
        const ids = this.telescopes.map((one) => one.id);
        let last = null;
        try {
          last = localStorage.getItem("mountnav-telescope");
        } catch { /* as above */ }
        if (ids.length && !ids.includes(this.id)) this.choose(ids.includes(last) ? last : ids[0]);
        else this.everything();
        return;
      }
      const id = this.id;
      const known = await getIfNew(this.path(), this.#known);
      if (id !== this.id) return;
      this.#heardFrom();
      this.#known = known;
      this.state = known.told;
      this.note("state");
      this.tell("state");
      const asked = this.asked ? `?ra_deg=${this.asked.ra_deg}&dec_deg=${this.asked.dec_deg}` : "";
      const sky = await get(this.path(`sky${asked}`));
      if (id !== this.id) return;
      this.sky = sky;
      this.#clock = { service: Date.parse(sky.utc), ticks: performance.now() };
      this.note("sky");
      this.tell("sky");
      if (this.state.job_id || (this.job && !this.job.finished_utc)) await this.#readJob(this.state.job_id ?? this.job.id);
    } catch (error) {
      this.#failed(error);
    }
  }

  async #read(what) {
    const id = this.id;
    if (!id) return;
    if (what === "journal-told") {
      this.tell("journal");
      return;
    }
    try {
      let told;
      if (what === "jobs") told = await get(this.path(`jobs?count=${JOBS}`));
      else if (what === "health" || what === "capabilities") told = await get(`/v1/${what}`);
      else if (what === "night" && this.can?.nights === false) told = null;
      else told = await get(this.path({ frame: "last-frame" }[what] ?? what));
      if (id !== this.id) return;
      if (what === "jobs") {
        if (told.length && (!this.job || this.job.created_utc <= told[0].created_utc)) {
          this.job = told[0];
          this.tell("job");
        }
      }
      if (what === "lease") told.heard_ms = Date.now();
      this[what] = told;
      this.note(what);
      if (what === "offsets") told.looks.forEach((one) => this.lookTimes.set(one.look_id, one.utc));
      this.tell(what);
      if (what === "capabilities") this.soon("night", 0);
      // a job that runs and isn't among the newest: is it still known?
      if (what === "jobs" && this.job && !this.job.finished_utc && !told.some((one) => one.id === this.job.id)) await this.#readJob(this.job.id);
    } catch (error) {
      if (id !== this.id || error instanceof AnotherKey) return;
      if (error instanceof Refused && [404, 409].includes(error.status)) {
        this[what] = null;
        this.note(what);
        this.tell(what);
      } else if (error instanceof Refused && ![401, 403].includes(error.status)) {
        this.note(what, error);
        this.soon(what, AGAIN_MS);
      }
    }
  }

  async #readJob(jobId) {
    let job;
    try {
      job = await get(`/v1/jobs/${encodeURIComponent(jobId)}`);
    } catch (error) {
      if (error.status !== 404) throw error;
      if (this.job?.id === jobId && !this.job.finished_utc) this.#forgotten();
      return;
    }
    if (job.telescope !== this.id) return;
    const ended = job.finished_utc && !this.job?.finished_utc;
    this.job = job;
    this.jobs = [job, ...this.jobs.filter((one) => one.id !== job.id)];
    this.tell("job");
    this.tell("jobs");
    if (ended) {
      this.soon("offsets", 1000);
      this.soon("tonight", 1000);
    }
  }

  /** The service knows the job no more that ran when it was last heard: nobody can say that it still runs. */
  #forgotten() {
    const detail = "The service was restarted and does not know this job any more. How it ended is not known; the journal shows what was seen";
    this.job = { ...this.job, state: "unknown", phase: "ended", finished_utc: this.job.created_utc, forgotten: true, problem: { detail } };
    this.tell("job");
  }

  #heard(kind, data) {
    if (kind === "gap") this.everything();
    if (data.telescope && data.telescope !== this.id) return;
    this.tell("event", kind, data);
    this.soon("journal-told", SOON_MS);
    if (data.look_id && data.mid_exposure_utc) this.lookTimes.set(data.look_id, data.mid_exposure_utc);
    if (["solved", "not-solved"].includes(kind)) {
      this.soon("frame", 150);
      this.soon("offsets", 1200);
      this.soon("tonight", 1500);
    }
    if (kind === "job") this.soon("jobs");
    if (kind.startsWith("lease")) this.soon("lease", 50);
    if (kind.startsWith("night") || kind === "frame") this.soon("night");
    if (data.job_id && this.id) this.#readJob(data.job_id).catch((error) => this.#failed(error));
  }

  #heardFrom() {
    this.#fresh = { ticks: performance.now(), clock: Date.now() };
    this.#shut = false;
    document.body.classList.remove("waiting");
    if (this.lostSince === null) return;
    this.lostSince = null;
    this.tell("link");
    if (this.id) this.everything();
  }

  #failed(error) {
    if (error instanceof Refused) {
      document.body.classList.remove("waiting");
      if ([401, 403].includes(error.status)) {
        // what was known before is of no moment that we could name
        Object.assign(this, { state: null, sky: null });
        this.#heardFrom();
        this.#shut = true;
        this.tell("state");
        this.tell("sky");
        this.tell("key", error);
      } else if (error.status === 404) this.telescopes = [];
      else for (const what of ["state", "sky"]) this.note(what, error);
    } else if (!(error instanceof NoConnection)) {
      console.error(error);
    }
  }

  /** What was not heard for a while is told as lost, with the moment it was last heard. */
  #judgeAge() {
    if (this.#fresh === null) return;
    // a computer that slept may have counted no ticks meanwhile; its clock tells
    const age = Math.max(performance.now() - this.#fresh.ticks, Date.now() - this.#fresh.clock);
    const allowed = document.hidden || this.#shut ? HIDDEN_MS + OLD_MS : OLD_MS;
    if (age > allowed && this.lostSince === null) {
      this.lostSince = new Date(Date.now() - age);
      this.lostUtc = this.#clock === null ? this.lostSince : new Date(this.#clock.service + (this.#fresh.ticks - this.#clock.ticks) * (this.health?.virtual?.speed ?? 1));
      this.tell("link");
    } else if (this.lostSince !== null) this.tell("link");
  }

  #link(up) {
    this.tell("stream", up);
    if (up && this.id) this.everything();
  }

  get hasKey() {
    return key.get() !== null;
  }
}
