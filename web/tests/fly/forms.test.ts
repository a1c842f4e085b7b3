import { describe, expect, it } from "vitest";
import type { Loop } from "../../src/api/drones";
import { excitationOf, initial, kinds } from "../../src/pages/fly/excitation/forms";
import { controlLoop } from "../../src/loops";
import { LOOPS, followed } from "../../src/pages/fly/loops";

const ALL: Loop[] = ["theta", "q", "M", "v", "x"];

describe("the form of an excitation", () => {
  it("has every kind for every loop, begins within its bounds, and is sent in the loop's unit", () => {
    for (const loop of ALL) {
      expect(kinds(loop).map((one) => one.kind)).toEqual([
        "impulse",
        "doublet",
        "3-2-1-1",
        "steps",
        "sweep",
        "prbs",
        "multisine",
      ]);
      for (const kind of kinds(loop)) {
        const values = initial(kind);
        for (const field of kind.fields) {
          if (field.type !== "number") continue;
          expect(values[field.name], `${loop} ${kind.kind} ${field.name}`).toBeGreaterThanOrEqual(field.low);
          expect(values[field.name]).toBeLessThanOrEqual(field.high);
        }
        const sent = excitationOf(kind, loop, values);
        expect([sent.kind, sent.version, sent["unit"]]).toEqual([kind.kind, 1, controlLoop(loop).unit]);
        expect(JSON.stringify(sent)).not.toContain("null");
      }
    }
  });
});

describe("what is followed", () => {
  const setpoints: Record<string, number> = { "setpoint.theta": Math.PI / 18, "setpoint.x": 0.1 };
  const at = (mode: number) => (column: string) => (column === "state.mode" ? mode : (setpoints[column] ?? 0));
  it("is what the drone tells, whoever gave it", () => {
    expect(followed(at(3), true)).toBe("follows pitch 10.00\u00a0deg");
    expect(followed(at(5), true)).toBe("follows position 0.100\u00a0m");
    expect(followed(at(1), true)).toBe("moment command, no loop closed");
    for (const none of [followed(at(3), false), followed(at(NaN), true), followed(at(0), true)])
      expect(none).toBe("follows no set-point");
  });
  it("has steps and a slider within what may be typed", () => {
    for (const row of LOOPS) {
      expect(row.slides).toBeLessThanOrEqual(row.most);
      for (const step of row.steps) expect(Math.abs(step)).toBeLessThanOrEqual(row.slides);
    }
  });
});
