import { afterAll, beforeAll, describe, expect, it, vi } from "vitest";
import type { DroneState } from "../src/api/drones";
import type { LabEvent, Telemetry } from "../src/api/telemetry";

const place = { hash: "#/fly?drone=2" };
const heard = new Map<string, (() => void)[]>();

function listen(name: string, tell: () => void): void {
  heard.set(name, [...(heard.get(name) ?? []), tell]);
}
function go(hash: string): void {
  place.hash = hash;
  for (const tell of heard.get("hashchange") ?? []) tell();
}

describe("the chosen drone", () => {
  beforeAll(() => {
    vi.stubGlobal("location", place);
    vi.stubGlobal("addEventListener", listen);
    vi.stubGlobal("document", { addEventListener: listen, hidden: false });
    vi.stubGlobal("history", { replaceState: (_: unknown, __: unknown, link: string) => (place.hash = link) });
    vi.useFakeTimers();
  });
  afterAll(() => {
    vi.useRealTimers();
    vi.unstubAllGlobals();
  });

  it("stays the chosen one where a link names none, as one to a log does: the stop acts on it", async () => {
    vi.resetModules();
    const { session } = await import("../src/state/session.svelte");
    let tell: (event: LabEvent) => void = () => {};
    session.start({
      onEvent: (listener: (event: LabEvent) => void) => (tell = listener),
      onConnection: () => {},
      start: () => {},
    } as unknown as Telemetry);
    for (const drone of [1, 2, 3]) tell({ event: "drone", drone, state: { system: drone } as DroneState });
    expect(session.number).toBe(2);
    go("#/logs/2026-11-24-drone-2.mcap");
    expect(session.number).toBe(2);
    session.choose(3);
    expect(place.hash).toContain("drone=3");
    go("#/identify");
    expect(session.number).toBe(3);
    go("#/fly?drone=1");
    expect(session.number).toBe(1);
  });

  it("can be told nothing while the server is lost, and not by a link that only watches", async () => {
    vi.resetModules();
    const { session } = await import("../src/state/session.svelte");
    let tell: (connected: boolean) => void = () => {};
    session.start({
      onEvent: () => {},
      onConnection: (listener: (connected: boolean) => void) => (tell = listener),
      start: () => {},
    } as unknown as Telemetry);
    vi.stubGlobal("fetch", () => new Promise(() => {}));
    vi.stubGlobal("sessionStorage", { getItem: () => null });
    tell(true);
    expect([session.off, session.serverLost]).toEqual(["", ""]);
    session.role = "watch";
    expect([session.off, session.serverLost]).toEqual(["This link can only watch.", ""]);
    tell(false);
    expect([session.off, session.serverLost]).toEqual(Array(2).fill("No connection to the server."));
  });
});
