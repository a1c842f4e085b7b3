import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { linkTo, readRoute } from "../src/app/read_route";

describe("a link", () => {
  it("names a page, its parts and what is asked of it", () => {
    const route = readRoute("#/logs/a%20b.mcap?at=12.5");
    expect([route.page, route.parts, route.query.get("at")]).toEqual(["logs", ["a b.mcap"], "12.5"]);
  });
  it("is the page to fly from when it is empty", () => {
    expect(readRoute("").page).toBe("fly");
  });
});

describe("where one is", () => {
  const here = { hash: "" };
  beforeEach(() => {
    vi.stubGlobal("location", here);
    vi.stubGlobal("history", { replaceState: (_: unknown, __: unknown, link: string) => (here.hash = link) });
    vi.stubGlobal("addEventListener", () => {});
  });
  afterEach(() => vi.unstubAllGlobals());

  it("is said by the page that one is on, not by one that was left while it waited for something", async () => {
    const { route } = await import("../src/app/route.svelte");
    here.hash = "#/diagram?starter=notch-attitude";
    route.go(linkTo("diagram", ["mine"]), true);
    expect(here.hash).toBe("#/diagram/mine");
    expect(route.now.parts).toEqual(["mine"]);
    route.go(linkTo("logs"));
    route.go(linkTo("diagram", ["another"]), true);
    expect(here.hash).toBe("#/logs");
    expect([route.on("logs"), route.on("diagram")]).toEqual([true, false]);
  });
});
