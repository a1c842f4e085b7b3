import { describe, expect, it } from "vitest";
import { labelled, type ParameterRow } from "../../src/api/tuning";
import {
  asRecord,
  boundsText,
  differences,
  grouped,
  groupOf,
  mistake,
  same,
  searched,
  shown,
  sliderEnds,
  slides,
  withChanges,
} from "../../src/pages/tune/draft";

function row(name: string, given: Partial<ParameterRow> = {}): ParameterRow {
  return labelled({
    name,
    value: 0.0854,
    kind: "float",
    default: 0.0854,
    low: 0,
    high: 0.12,
    unit: "s/rad",
    text: "rate loop, proportional gain",
    path: "",
    tuning: true,
    same_as: "",
    ...given,
  });
}
const ROWS = [
  row("SAFE_LINK_T", { unit: "s", text: "silence of the link", tuning: false, high: 30, value: 3, default: 3 }),
  row("RATE_KP"),
  row("FC_PARAM_4", { same_as: "RATE_KP" }),
  row("AC_Q_KP", { path: "attitude_control.q_kp", text: "" }),
  row("BAT1_N_CELLS", {
    text: "cells of the battery",
    kind: "int32",
    unit: "",
    value: 3,
    default: 3,
    high: 6,
    tuning: false,
  }),
];

it("says that the user's controller replaces a loop", () => {
  const named = (rows: ParameterRow[], all: ParameterRow[]) => grouped(rows, all).map(([group]) => group);
  expect(named([row("RATE_KP"), row("VEL_KP")], ROWS)).toEqual([
    "Rate loop: replaced by your controller",
    "Velocity loop",
  ]);
  expect(named([row("RATE_KP")], [row("RATE_KP")])).toEqual(["Rate loop"]);
});

it("shows the corner of a filter in rad/s, and other rates in deg/s", () => {
  const corner = row("RATE_N", {
    unit: "rad/s",
    text: "rate loop, corner of the derivative's filter",
    low: 1,
    high: 250,
  });
  expect(shown(100, corner.unit)).toBe("100");
  expect(boundsText(corner)).toBe("1 to 250 rad/s");
  expect(boundsText(row("Q_MAX", { unit: "rad/s", text: "largest rate set-point", low: 0, high: Math.PI }))).toBe(
    "0 to 180 deg/s",
  );
});

describe("the list", () => {
  it("puts a user's controller first and the failsafe and the vehicle last, each number once", () => {
    const names = grouped(ROWS).map(([group, rows]) => [group, rows.map((one) => one.name)]);
    expect(names).toEqual([
      ["Your controller: attitude control", ["AC_Q_KP"]],
      ["Rate loop: replaced by your controller", ["RATE_KP"]],
      ["Failsafe", ["SAFE_LINK_T"]],
      ["Vehicle", ["BAT1_N_CELLS"]],
    ]);
    expect(groupOf(ROWS[0]!)).toBe("Failsafe");
  });
  it("has the gains of a loop as everybody writes them", () => {
    const names = ["RATE_KD", "RATE_KI", "RATE_KP", "RATE_N"].map((name) => row(name));
    expect(grouped(names)[0]![1].map((one) => one.name)).toEqual(["RATE_KP", "RATE_KI", "RATE_KD", "RATE_N"]);
  });
  it("is searched by every word, by the real drone's name, by path and group", () => {
    expect(searched(ROWS, "prop rate").map((one) => one.name)).toEqual(["RATE_KP", "FC_PARAM_4"]);
    expect(searched(ROWS, "fc_param_4").map((one) => one.name)).toContain("RATE_KP");
    expect(searched(ROWS, "q_kp").map((one) => one.name)).toEqual(["AC_Q_KP"]);
    expect(searched(ROWS, "")).toHaveLength(ROWS.length);
  });
});

describe("the edits", () => {
  it("differ only where the drone's float32 would", () => {
    expect(same(row("A"), 0.08540000021457672, 0.0854)).toBe(true);
    const edits = new Map([
      ["RATE_KP", 0.08540000021457672],
      ["SAFE_LINK_T", 2],
    ]);
    const found = differences(ROWS, edits);
    expect(found).toEqual([{ name: "SAFE_LINK_T", label: "SAFE_LINK_T", before: 3, value: 2, unit: "s" }]);
    expect(asRecord(found)).toEqual({ SAFE_LINK_T: 2 });
  });
  it("take a snapshot's values as far as the drone has them", () => {
    const changes = [
      { name: "RATE_KP", before: 0.0854, value: 0.07 },
      { name: "NOT_HERE", before: null, value: 1 },
      { name: "SAFE_LINK_T", before: 3, value: null },
    ];
    expect([...withChanges(ROWS, new Map([["RATE_KP", 0.1]]), changes)]).toEqual([["RATE_KP", 0.07]]);
  });
  it("stay within the bounds, and whole where they are whole", () => {
    expect(mistake(ROWS[1]!, 0.07)).toBe("");
    expect(mistake(ROWS[1]!, 0.2)).toContain("0.12");
    expect(mistake(ROWS[4]!, 2.5)).toContain("whole");
    expect(boundsText(row("SAFE_LINK_T", { unit: "s", low: 0, high: 30 }))).toBe("0 to 30 s");
    expect(mistake(row("OWN", { low: -3.4028234663852886e38, high: 3.4028234663852886e38 }), 1e9)).toBe("");
  });
});

describe("a parameter of an own diagram", () => {
  const NONE = { low: -3.4028234663852886e38, high: 3.4028234663852886e38 };
  const own = (path: string, given: Partial<ParameterRow> = {}) =>
    row("TMP_PID_N", { path: `attitude_control.${path}`, text: `attitude_control.${path}: corner`, ...given });
  it("has its whole name, its words and the unit of the diagram", () => {
    const corner = own("pid.N", { unit: "rad/s", value: 100, default: 100, low: 0, high: NONE.high });
    expect([corner.label, corner.text]).toEqual(["pid.N", "corner"]);
    expect(shown(corner.value, corner.unit)).toBe("100");
    expect(boundsText(corner)).toBe("at least 0 rad/s");
    expect(mistake(corner, 150)).toBe("");
    expect(own("k", { text: "attitude_control.k" }).text).toBe("");
  });
  it("has a slider without bounds too, which reaches past its value", () => {
    expect(slides(own("k", NONE))).toBe(true);
    expect(slides(row("RATE_LIMIT", NONE))).toBe(false);
    expect(boundsText(own("k", NONE))).toBe("no bounds");
    for (const [given, ends] of [
      [{ default: 3, value: 3 }, [0, 6]],
      [{ default: -3, value: -9 }, [-9, 0]],
      [{ default: 0, value: 0 }, [-1, 1]],
      [{ default: 3, value: 3, low: 1 }, [1, 6]],
      [{ default: 0.001, value: 0.001, low: 0, high: 0.05 }, [0, 0.002]],
      [{ default: 0.001, value: 0.01, low: 0, high: 0.05 }, [0, 0.01]],
      [{ default: 1, value: 1, low: -1, high: 1 }, [-1, 1]],
    ] as const)
      expect(sliderEnds(own("k", { ...NONE, ...given }))).toEqual(ends);
  });
});
