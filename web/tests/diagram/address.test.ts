import { describe, expect, it } from "vitest";
import { readRoute } from "../../src/app/read_route";
import { addressOf, askedBy } from "../../src/pages/diagram/address";

describe("the address of the Diagram page", () => {
  it("asks for another diagram than the one that is open", () => {
    expect(askedBy(readRoute("#/diagram/mine"), "other")).toEqual({ file: "mine" });
    expect(askedBy(readRoute("#/diagram/mine"), "mine")).toBeUndefined();
    expect(askedBy(readRoute("#/diagram?starter=pid"), "mine")).toEqual({ starter: "pid" });
    expect(askedBy(readRoute("#/diagram?drone=2"), "mine")).toBeUndefined();
  });
  it("is that of what is open, with the drone", () => {
    expect(addressOf("my own", readRoute("#/diagram/x?starter=pid&drone=2"))).toBe("#/diagram/my%20own?drone=2");
    expect(addressOf("", readRoute("#/diagram?starter=pid"))).toBe("#/diagram");
  });
});
