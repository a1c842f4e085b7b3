import { describe, expect, it } from "vitest";
import { LineView } from "../src/chart/views.svelte";
import { OpenLog } from "../src/pages/logs/open_log.svelte";
import { isThinned, nameAndUnit, panels, spliced } from "../src/pages/logs/curves";
import { advance, Replay } from "../src/pages/logs/replay";
import { float32s, float64s, staircase } from "../src/pages/logs/unpack";
import { duration, flown, notALog, sentName, size, sparkPath } from "../src/pages/logs/words";

const packed = (values: Float32Array | Float64Array): string =>
  btoa(String.fromCharCode(...new Uint8Array(values.buffer)));

describe("numbers as the server packs them", () => {
  it("come back to the bit", () => {
    const times = new Float64Array([0.1, 1e9, -0, Number.MIN_VALUE]);
    expect(float64s(packed(times))).toEqual(times);
    const values = new Float32Array([0.1, NaN, Infinity]);
    expect(float32s(packed(values))).toEqual(values);
  });
  it("of a held signal make a staircase", () => {
    const { x, y } = staircase(new Float64Array([0, 1, 3]), new Float32Array([5, 6, 7]));
    expect([...x]).toEqual([0, 1, 1, 3, 3]);
    expect([...y]).toEqual([5, 5, 6, 6, 7]);
    expect(staircase(new Float64Array(0), new Float32Array(0)).x.length).toBe(0);
  });
});

describe("the time of an open log", () => {
  it.each([
    [86.4, 0],
    [1.7e9, 1.7e9],
  ])("that begins at %d s is counted from %d s: Unix time is too long for an axis", (begin, zero) => {
    const log = new OpenLog("a.csv");
    log.facts = { span: [begin, begin + 10] } as OpenLog["facts"];
    expect(log.view.origin()).toBe(zero);
  });
});

describe("a replay", () => {
  const replay = new Replay({
    start: 10,
    rate: 2,
    count: 3,
    columns: {
      theta: packed(new Float32Array([0, 0.2, NaN])),
      x: packed(new Float32Array([1, 2, 3])),
      theta0: packed(new Float32Array([0.5, 0.5, 0.5])),
      M: packed(new Float32Array([0.25, 0, 0])),
      T: packed(new Float32Array([0.5, 0, 0])),
    },
  });
  it("is straight between samples and known in the log only", () => {
    expect(replay.at("x", 10.25)).toBeCloseTo(1.5);
    expect(replay.at("theta", 10.25)).toBeCloseTo(0.1);
    expect(replay.at("theta", 10.75)).toBeCloseTo(0.2); // what comes next is not known
    expect(replay.at("x", 9.9)).toBeNaN();
    expect(replay.at("x", 11.6)).toBeNaN();
    expect(replay.at("q", 10)).toBeNaN();
  });
  it("poses the rig, and rests where nothing is known", () => {
    expect(replay.pose(10)).toEqual({ x: 1, theta: 0, fore: 0.75, aft: 0.25 });
    expect(replay.pose(99)).toEqual({ x: 0, theta: 0, fore: 0, aft: 0 });
    expect(replay.truth(10)).toBeUndefined();
  });
  it("shows a set-point while its loop is closed", () => {
    expect(replay.wanted(10, "attitude").theta).toBe(0.5);
    expect(replay.wanted(10, "rate").theta).toBeUndefined();
  });
  it("goes on with its speed, stops at the end, and does not jump after a sleep", () => {
    expect(advance(10, 0.1, 2, [10, 20])).toEqual({ time: 10.2, over: false });
    expect(advance(19.95, 0.1, 1, [10, 20])).toEqual({ time: 20, over: true });
    expect(advance(10, 3600, 1, [10, 20]).time).toBe(10.25);
    expect(advance(0, 0, 1, [10, 20]).time).toBe(10);
  });
});

describe("curves", () => {
  const curve = (label: string, held = false) => ({
    label,
    channel: label,
    held,
    time: packed(new Float64Array([0, 1])),
    value: packed(new Float32Array([2, 3])),
  });
  const view = { views: [{ label: "pitch θ [deg]", curves: [curve("estimated"), curve("set-point", true)] }] };
  it("have the colours of what they are", () => {
    const [panel] = panels(view);
    expect(panel!.unit).toBe("deg");
    expect(panel!.series.map((one) => [one.kind, one.colour])).toEqual([
      ["estimate", undefined],
      ["set-point", undefined],
    ]);
    expect(panel!.series[1]!.x.length).toBe(3);
    expect(isThinned([panel!], 2)).toBe(true);
    expect(isThinned([panel!], 100)).toBe(false);
  });
  it("of several flights have one colour each, in every plot", () => {
    const both = { views: [{ label: "a", curves: [curve("B"), curve("A")] }] };
    expect(panels(both, ["A", "B"])[0]!.series.map((one) => one.colour)).toEqual(["series-2", "series-1"]);
  });
  it("take the samples of a finer part, and keep their own around it", () => {
    const line = (x: number[], y: number[]) => ({
      label: "q",
      kind: "estimate" as const,
      x: Float64Array.from(x),
      y: Float64Array.from(y),
    });
    const whole = line([0, 1, 2, 3, 4], [0, 1, 2, 3, 4]);
    const { x, y } = spliced(whole, line([1, 1.5, 2.5], [9, 8, 7]));
    expect([...x]).toEqual([0, 1, 1.5, 2.5, 3, 4]);
    expect([...y]).toEqual([0, 9, 8, 7, 3, 4]);
    expect(spliced(whole, line([], []))).toBe(whole);
  });
  it("know their unit", () => {
    expect(nameAndUnit("motors M, T [–]")).toEqual(["motors M, T", ""]);
    expect(nameAndUnit("temperature")).toEqual(["temperature", ""]);
  });
});

describe("a view", () => {
  it("takes eight cursors, and removes the one that is pressed again", () => {
    const view = new LineView(() => [0, 100]);
    for (const x of [10, 20, 30, 20.2]) view.pin(x);
    expect(view.pins).toEqual([10, 30]);
    for (const x of [40, 50, 60, 70, 80, 90, 95]) view.pin(x);
    expect(view.pins.length).toBe(8);
  });
});

describe("words about logs", () => {
  it("a dropped file gets a name that the server takes", () => {
    for (const name of [
      "Flug #3 (neu).ulg",
      "../../etc/passwd.mat",
      ".hidden.csv",
      "日本.mcap",
      "a..b.mat",
      "x".repeat(300) + ".mat",
    ]) {
      const sent = sentName(name);
      expect(sent).toMatch(/^[A-Za-z0-9][A-Za-z0-9_. +-]*\.(ulg|mat|csv|mcap)$/);
      expect(sent).not.toContain("..");
      expect(sent.length).toBeLessThanOrEqual(120);
    }
    expect(sentName("flight 3.mcap")).toBe("flight 3.mcap");
  });
  it("says what is not worth sending", () => {
    expect(notALog({ name: "a.exe", size: 1 })).toContain("is not a log");
    expect(notALog({ name: "a.MAT", size: 0 })).toContain("empty");
    expect(notALog({ name: "a.ulg", size: 2 ** 30 })).toContain("256 MiB");
    expect(notALog({ name: "a.ulg", size: 5 })).toBe("");
  });
  it("says sizes, times, and what flew", () => {
    expect([size(10), size(2_289_408), duration(18.51), duration(125.2)]).toEqual([
      "1 kB",
      "2.3 MB",
      "18.5 s",
      "2 min 05 s",
    ]);
    const told = { drone: 6, rig: "lab", virtual: true, controller: "stock", tuned: [["ATT_KP", 5]] };
    expect(flown(told as never)).toBe("drone 6, rig lab (virtual), stock controllers, ATT_KP 5");
  });
  it("draws a spark with holes where nothing was logged, and a flat one in the middle", () => {
    expect(sparkPath([0, 1, null, 0], [1, 1, null, 0], 40, 10)).toBe(
      "M5.0 0.0L5.0 10.0L15.0 0.0L15.0 0.0M35.0 10.0L35.0 10.0",
    );
    expect(sparkPath([3], [3], 10, 10)).toBe("M5.0 5.0L5.0 5.0");
    expect(sparkPath([null], [null], 10, 10)).toBe("");
  });
});
