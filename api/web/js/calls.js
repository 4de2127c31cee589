// Calls of /v1: key and lease as headers, problems as errors, orders that are never given twice, and never after a STOP.

const KEPT = "mountnav-key";
const TIMEOUT_MS = 10_000;
const ORDER_TRIES = 4;

/** The service said no: `problem` is its problem+json. */
export class Refused extends Error {
  constructor(problem, status) {
    const words = problem.detail || problem.title || `HTTP ${status}`;
    super(problem.advice ? `${words}: ${problem.advice}` : words);
    this.problem = problem;
    this.status = status;
    this.slug = String(problem.type || "").split(":").pop();
  }
}

/** No answer came: whether the service heard it is not known. */
export class NoConnection extends Error {}

/** The key was changed while this was read: the answer belongs to a key that nobody holds here any more. */
export class AnotherKey extends NoConnection {}

/** A STOP came while the order had no answer: it is not asked again. */
export class Dropped extends Error {}

export const key = {
  get: () => sessionStorage.getItem(KEPT),
  use: (value) => sessionStorage.setItem(KEPT, value),
  forget: () => sessionStorage.removeItem(KEPT),
};

/** The secrets of the leases that this tab holds, by telescope; they outlive a reload, and no tab. */
export const lease = {
  get: (telescope) => sessionStorage.getItem(`mountnav-lease ${telescope}`),
  use: (telescope, secret) => sessionStorage.setItem(`mountnav-lease ${telescope}`, secret),
  forget: (telescope) => sessionStorage.removeItem(`mountnav-lease ${telescope}`),
};

export function headersWithLease(telescope, more = {}) {
  const secret = lease.get(telescope);
  return secret ? { ...more, "Mountnav-Lease": secret } : more;
}

/** Whether a header can carry it. With any other letter in a header nothing is sent at all, not even a STOP. */
export const isPlain = (text) => /^[\x20-\x7e]*$/.test(text);

export function headersWithKey(more = {}) {
  const value = key.get();
  return value && isPlain(value) ? { ...more, "X-API-Key": value } : more;
}

async function asked(method, path, { body, headers = {}, timeoutMs = TIMEOUT_MS, raw, dropped } = {}) {
  const given = headersWithKey({ Accept: "application/json", ...headers });
  if (body !== undefined) given["Content-Type"] = "application/json";
  const over = new AbortController();
  let late = false;
  setTimeout(() => {
    late = true;
    over.abort(); // ends the reading of the answer as well
  }, timeoutMs);
  dropped?.addEventListener("abort", () => over.abort());
  try {
    return await fetch(path, {
      method, headers: given, cache: "no-store", signal: over.signal,
      body: raw ?? (body === undefined ? undefined : JSON.stringify(body)),
    });
  } catch {
    throw new NoConnection(late ? "no answer in time" : "no connection");
  }
}

async function answered(response) {
  if (response.status === 204) return null;
  let told = {};
  try {
    told = await response.json();
  } catch {
    if (response.ok) throw new NoConnection("the answer was cut off");
    // a proxy speaks for a service that didn't: whether that took an order is not known
    if ([502, 503, 504].includes(response.status)) throw new NoConnection(`the proxy had no answer (HTTP ${response.status})`);
  }
  if (!response.ok) throw new Refused(told, response.status);
  return told;
}

/** What is read under one key counts as long as that key is held: what comes late says nothing of the next one. */
async function underOneKey(read) {
  const mine = key.get();
  const same = () => {
    if (key.get() !== mine) throw new AnotherKey("the key was changed meanwhile");
  };
  try {
    const told = await read();
    same();
    return told;
  } catch (error) {
    same();
    throw error;
  }
}

export const get = (path) => underOneKey(async () => answered(await asked("GET", path)));

/** GET that costs nothing while nothing changed: `known` is what it returned last time. */
export function getIfNew(path, known) {
  const headers = known?.etag ? { "If-None-Match": known.etag } : {};
  return underOneKey(async () => {
    const response = await asked("GET", path, { headers, timeoutMs: 4000 });
    if (response.status === 304) return known;
    return { told: await answered(response), etag: response.headers.get("ETag") };
  });
}

/** A question with a body: it changes nothing. */
export const ask = (path, body) => underOneKey(async () => answered(await asked("POST", path, { body, timeoutMs: 20_000 })));

/**
 * Move an axis on for a moment. Sent once: a motion that comes late is one that nobody holds any more. After a STOP it is
 * Dropped, so that it can't come behind it.
 */
export async function moveAxis(telescope, body, timeoutMs) {
  const headers = headersWithLease(telescope, { "Idempotency-Key": newKey() });
  const mine = { telescope, dropped: new AbortController() }, dropped = mine.dropped.signal;
  underWay.add(mine);
  try {
    return await answered(await asked("POST", `/v1/telescopes/${encodeURIComponent(telescope)}/move-axis`, { body, headers, dropped, timeoutMs }));
  } catch (error) {
    if (dropped.aborted) throw new Dropped("STOP came before its answer");
    throw error;
  } finally {
    underWay.delete(mine);
  }
}

export const remove = async (path) => answered(await asked("DELETE", path));

/** Take, keep or give back a lease: POST, PUT, DELETE. */
export async function leaseCall(method, telescope, body) {
  const path = `/v1/telescopes/${encodeURIComponent(telescope)}/lease`;
  return answered(await asked(method, path, { body, headers: headersWithLease(telescope) }));
}

export async function picture(path) {
  const response = await asked("GET", path, { headers: { Accept: "image/*" } });
  if (!response.ok) return answered(response);
  return response.blob();
}

/** Send a file to be solved; the answer is the record of the solve. */
export async function solveFile(file, telescope) {
  const form = new FormData();
  form.append("file", file, file.name);
  const query = telescope ? `?telescope=${encodeURIComponent(telescope)}` : "";
  return answered(await asked("POST", `/v1/solve${query}`, { raw: form, timeoutMs: 180_000 }));
}

const underWay = new Set();

/** Ask for no order again whose answer is missing: a STOP comes after it. Of one telescope, or of all (null). */
export function dropOrders(telescope) {
  for (const one of underWay) if (telescope === null || one.telescope === telescope) one.dropped.abort();
}

/**
 * Give an order. Without an answer it is sent again under the same Idempotency-Key, so that it is carried out once
 * at most; if no answer ever comes, NoConnection says so and nobody knows. After a STOP it is Dropped.
 */
export async function order(telescope, path, body, onRetry = () => {}) {
  const headers = headersWithLease(telescope, { "Idempotency-Key": newKey() });
  const mine = { telescope, dropped: new AbortController() }, dropped = mine.dropped.signal;
  underWay.add(mine);
  try {
    for (let attempt = 1; ; attempt++) {
      try {
        return await answered(await asked("POST", path, { body, headers, dropped }));
      } catch (error) {
        if (dropped.aborted) throw new Dropped("STOP came before its answer; it is not asked again");
        if (!(error instanceof NoConnection) || attempt >= ORDER_TRIES) throw error;
      }
      onRetry(attempt);
      await new Promise((done) => {
        setTimeout(done, 700 * attempt);
        dropped.addEventListener("abort", done);
      });
      if (dropped.aborted) throw new Dropped("STOP came before its answer; it is not asked again");
    }
  } finally {
    underWay.delete(mine);
  }
}

function newKey() {
  // crypto.randomUUID is there on secure pages alone, and an observatory's own network has no TLS as a rule
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return `page-${[...bytes].map((one) => one.toString(16).padStart(2, "0")).join("")}`;
}
