import { describe, expect, it } from "vitest";
import { readRoute } from "../src/app/read_route";

describe("a link", () => {
  it("names a page, its parts and what is asked of it", () => {
    const route = readRoute("#/logs/a%20b.mcap?at=12.5");
    expect([route.page, route.parts, route.query.get("at")]).toEqual(["logs", ["a b.mcap"], "12.5"]);
  });
  it("is the page to fly from when it is empty", () => {
    expect(readRoute("").page).toBe("fly");
  });
});
