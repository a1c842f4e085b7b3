// Calls of the server's API. A refusal carries what the server says: what is wrong, where, and what to do about it.

/** Refusal of the server; status 0 if it was not reached. */
export class ApiError extends Error {
  constructor(
    readonly status: number,
    readonly what: string,
    readonly where = "",
    readonly remedy = "",
  ) {
    super(`${what}${where && ` (${where})`}${remedy && `: ${remedy}`}`);
  }
}

export const TOKEN = "twodof-token";

/** Store the token of a link `?token=...` for this tab and remove it from the address. */
export function takeToken(): void {
  const here = new URL(location.href);
  const given = here.searchParams.get("token");
  if (given === null) return;
  sessionStorage.setItem(TOKEN, given);
  here.searchParams.delete("token");
  history.replaceState(null, "", here);
}

export function token(): string {
  return sessionStorage.getItem(TOKEN) ?? "";
}

export function apiUrl(path: string): URL {
  return new URL(`api/${path.replace(/^\//, "")}`, document.baseURI.split("#")[0]);
}

export function messageOf(failure: unknown): string {
  return failure instanceof Error ? failure.message : String(failure);
}

/** Send a request. Raises ApiError if the server refuses, is silent for `timeout` [s], or `end` aborts. */
export async function request(
  method: string,
  path: string,
  body?: unknown,
  timeout = 30,
  end?: AbortSignal,
): Promise<Response> {
  const headers = new Headers();
  if (token()) headers.set("Authorization", `Bearer ${token()}`);
  const raw = body instanceof Blob || body instanceof ArrayBuffer;
  if (body !== undefined && !raw) headers.set("Content-Type", "application/json");
  const init: RequestInit = { method, headers, signal: ended(timeout, end) };
  if (body !== undefined) init.body = raw ? body : JSON.stringify(body);
  let response: Response;
  try {
    response = await fetch(apiUrl(path), init);
  } catch (failure) {
    const silent = failure instanceof DOMException && failure.name === "TimeoutError";
    if (!silent) throw unreached(path);
    throw new ApiError(0, `the server did not answer within ${timeout} s`, path, "see that `twodof up` runs");
  }
  if (response.ok) return response;
  throw refusal(response.status, await response.json().catch(() => ({})));
}

export const AGAIN_MS = 2000;
/** Status without an answer in time, of too many requests, and of work that took too long. */
const SLOW = [0, 429, 503, 504];

/** Return whether the computer is too busy, so that the same request may succeed later. */
export const isSlow = (failure: unknown) => failure instanceof ApiError && SLOW.includes(failure.status);

/** Ask again while the computer is too busy to answer, until `ended`; tell `waits` of each failure. */
export async function patiently<T>(
  ask: () => Promise<T>,
  ended: () => boolean = () => false,
  waits: (failure: unknown) => void = () => {},
): Promise<T> {
  for (;;) {
    try {
      return await ask();
    } catch (failure) {
      if (ended() || !isSlow(failure)) throw failure;
      waits(failure);
    }
    await new Promise((done) => setTimeout(done, AGAIN_MS));
  }
}

function refusal(status: number, answer: unknown): ApiError {
  const said = answer as { what?: string; where?: string; remedy?: string };
  return new ApiError(status, said.what ?? `the server refuses (${status})`, said.where, said.remedy);
}

function unreached(path: string): ApiError {
  return new ApiError(0, "no connection to the server", path, "see that `twodof up` runs");
}

function ended(timeout: number, end: AbortSignal | undefined): AbortSignal {
  const late = AbortSignal.timeout(timeout * 1000);
  return end === undefined ? late : AbortSignal.any([late, end]);
}

export const get = <T>(path: string) => send<T>("GET", path);
/** Send a request as `request` does, and return the JSON of the answer. */
export async function send<T>(...asked: Parameters<typeof request>): Promise<T> {
  const response = await request(...asked);
  return (response.status === 204 ? undefined : await response.json()) as T;
}

/**
 * Send `content` and return the JSON of the answer. Calls `sent` with the share that was sent, 0 to 1, which fetch does
 * not report. Has no time limit. Raises ApiError, or the reason of `end`.
 */
export function upload(path: string, content: Blob, sent: (share: number) => void, end: AbortSignal): Promise<unknown> {
  return new Promise((done, failed) => {
    end.throwIfAborted();
    const asked = new XMLHttpRequest();
    asked.open("POST", apiUrl(path));
    if (token()) asked.setRequestHeader("Authorization", `Bearer ${token()}`);
    asked.responseType = "json";
    asked.upload.onprogress = (event) => sent(event.total > 0 ? event.loaded / event.total : 1);
    asked.onload = () =>
      asked.status < 300 ? done(asked.response as unknown) : failed(refusal(asked.status, asked.response ?? {}));
    asked.onerror = () => failed(unreached(path));
    asked.onabort = () => failed(end.reason as Error);
    end.addEventListener("abort", () => asked.abort(), { once: true });
    asked.send(content);
  });
}

/** Return the role of this client, and the path of the link that only watches ("" if there is none). */
export const labSession = () => get<{ role: "command" | "watch"; watch_link: string }>("session");

export const viewersLink = (watchLink: string, here: URL): string => new URL(watchLink, here).href + here.hash;

/** Return whether a link works on this computer only. */
export const isThisComputerOnly = (link: URL): boolean => /^(localhost|127(\.\d+){3}|\[::1\])$/.test(link.hostname);
