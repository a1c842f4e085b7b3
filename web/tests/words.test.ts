import { describe, expect, it } from "vitest";
import type { DroneState } from "../src/api/drones";
import { ApiError } from "../src/api/client";
import { figure } from "../src/chart/numbers";
import { armedWord, leaseWord } from "../src/state/words";

describe("who commands", () => {
  const state = (part: Partial<DroneState>) =>
    leaseWord({ link: "heard", ours_leases: false, lease_holder: null, ...part } as DroneState).text;
  it("is you, none, an experiment that this server began, or another client by its number", () => {
    expect(state({ ours_leases: true })).toBe("You command");
    expect(state({})).toBe("Not commanded");
    expect(state({ lease_holder: [242, 190], experiment: true })).toBe("Commanded by an experiment");
    expect(state({ lease_holder: [242, 190], experiment: false })).toBe("Commanded by client 242");
    expect(state({ ours_leases: true, link: "lost" })).toBe("Command unknown");
  });
});

describe("whether it is armed", () => {
  const armed = (link: DroneState["link"]) => ({ link, armed: true, killed: false }) as DroneState;
  it("is told as of the last word where the drone is not heard", () => {
    expect(armedWord(armed("heard")).text).toBe("Armed");
    expect(armedWord(armed("lost"))).toEqual({ kind: "plain", text: "Armed when last heard" });
    expect(armedWord(armed("heard"), false).text).toBe("Armed when last heard");
  });
});

describe("a number for reading", () => {
  it("has the minus of print, but for an exponent", () => {
    expect([-10, -0.01, 0, -2.5e-7].map((one) => figure(one, 3))).toEqual([
      "\u221210.0",
      "\u22120.01",
      "0.00",
      "\u22122.50e-7",
    ]);
  });
});

describe("a refusal", () => {
  it("is one sentence: what, where, and the remedy", () => {
    expect(new ApiError(409, "it is armed", "drone 1", "disarm it first").message).toBe(
      "it is armed (drone 1): disarm it first",
    );
    expect(new ApiError(404, "no such log").message).toBe("no such log");
  });
});
