import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { upload } from "../src/api/client";

/** What a browser does of an XMLHttpRequest, at the test's word. */
class Asked {
  static last: Asked;
  upload: { onprogress: (event: { loaded: number; total: number }) => void } = { onprogress: () => {} };
  status = 0;
  response: unknown = null;
  onload = (): void => {};
  onerror = (): void => {};
  onabort = (): void => {};
  constructor() {
    Asked.last = this;
  }
  open(): void {}
  setRequestHeader(): void {}
  send(): void {}
  abort(): void {
    this.onabort();
  }
  answer(status: number, response: unknown): void {
    [this.status, this.response] = [status, response];
    this.onload();
  }
}

describe("an upload", () => {
  const ending = { now: new AbortController() };
  const shares: number[] = [];
  const start = () => upload("logs/a.mcap", new Blob(["x"]), (share) => shares.push(share), ending.now.signal);

  beforeEach(() => {
    vi.stubGlobal("XMLHttpRequest", Asked);
    vi.stubGlobal("document", { baseURI: "http://127.0.0.1/" });
    vi.stubGlobal("sessionStorage", { getItem: () => "t" });
    ending.now = new AbortController();
    shares.length = 0;
  });
  afterEach(() => vi.unstubAllGlobals());

  it("tells how far it is, and answers what the server does", async () => {
    const sent = start();
    Asked.last.upload.onprogress({ loaded: 1, total: 4 });
    Asked.last.upload.onprogress({ loaded: 4, total: 4 });
    Asked.last.answer(200, { name: "a.mcap" });
    expect(await sent).toEqual({ name: "a.mcap" });
    expect(shares).toEqual([0.25, 1]);
  });

  it("is refused with the server's words", async () => {
    const sent = start();
    Asked.last.answer(422, { what: "it is no log", where: "a.mcap", remedy: "give one" });
    await expect(sent).rejects.toThrow("it is no log (a.mcap): give one");
  });

  it("ends when it is told to", async () => {
    const sent = start();
    ending.now.abort();
    await expect(sent).rejects.toBe(ending.now.signal.reason);
    await expect(start()).rejects.toBe(ending.now.signal.reason);
  });

  it("says that no connection to the server", async () => {
    const sent = start();
    Asked.last.onerror();
    await expect(sent).rejects.toThrow("no connection to the server");
  });
});
