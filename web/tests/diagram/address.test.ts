import { describe, expect, it } from "vitest";
import { readRoute } from "../../src/app/read_route";
import { addressOf, askedBy, type Opened } from "../../src/pages/diagram/address";

const opened = (file: string, starter = ""): Opened => ({ file, starter });

describe("the address of the Diagram page", () => {
  it("asks for another diagram than the one that is open", () => {
    expect(askedBy(readRoute("#/diagram/mine"), opened("other"))).toEqual({ file: "mine" });
    expect(askedBy(readRoute("#/diagram/mine"), opened("mine"))).toBeUndefined();
    expect(askedBy(readRoute("#/diagram?starter=pid"), opened("mine"))).toEqual({ starter: "pid" });
    expect(askedBy(readRoute("#/diagram?starter=pid"), opened("", "pid"))).toBeUndefined();
    expect(askedBy(readRoute("#/diagram?drone=2"), opened("mine"))).toBeUndefined();
  });
  it("is that of what is open, with the drone", () => {
    expect(addressOf(opened("my own"), readRoute("#/diagram/x?starter=pid&drone=2"))).toBe(
      "#/diagram/my%20own?drone=2",
    );
    expect(addressOf(opened("", "pid"), readRoute("#/diagram"))).toBe("#/diagram?starter=pid");
    expect(addressOf(opened(""), readRoute("#/diagram?starter=pid"))).toBe("#/diagram");
  });
});
