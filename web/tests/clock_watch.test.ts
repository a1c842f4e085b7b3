import { describe, expect, it } from "vitest";
import { ClockWatch } from "../src/state/clock_watch";

describe("the watch over this page's clocks", () => {
  const watch = () => {
    const clocks = { counted: 0, told: 1e12 };
    return {
      clocks,
      watch: new ClockWatch(
        () => clocks.counted,
        () => clocks.told,
      ),
    };
  };
  it("is silent while time passes as it should", () => {
    const { clocks, watch: it } = watch();
    for (let k = 0; k < 10; k++) {
      clocks.counted += 1000;
      clocks.told += 1003;
      expect(it.look()).toBeUndefined();
    }
  });
  it("notices a tab that stood still for a minute, once", () => {
    const { clocks, watch: it } = watch();
    clocks.counted += 60_000;
    clocks.told += 60_000;
    expect(it.look()).toEqual({ kind: "stood still", seconds: 60 });
    expect(it.look()).toBeUndefined();
  });
  it("notices a clock that was set, either way", () => {
    for (const seconds of [3600, -3600]) {
      const { clocks, watch: it } = watch();
      clocks.counted += 1000;
      clocks.told += 1000 + 1000 * seconds;
      expect(it.look()).toEqual({ kind: "clock set", seconds });
    }
  });
});
