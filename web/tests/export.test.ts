import { describe, expect, it } from "vitest";
import { historyCsv } from "../src/chart/export";
import { History } from "../src/chart/history";
import { DEGREES, type Channel } from "../src/chart/kinds";

const CHANNELS: Channel[] = [
  { column: "setpoint.theta", label: "set-point", kind: "set-point", unit: "deg", factor: DEGREES },
  { column: "setpoint.x", label: "set-point", kind: "set-point", unit: "m" },
  { column: "estimate.x", label: "estimate", kind: "estimate", unit: "m" },
  { column: "command.M", label: "command", kind: "input", unit: "" },
];

describe("the strip charts as CSV", () => {
  const history = new History(CHANNELS.map((one) => one.column));
  const ticks = [0, 1, 2];
  history.append({
    time: ticks.map((tick) => 173.896 + 0.004 * tick),
    columns: [
      [0.1, 0.1, 0.1],
      [0, 0.1, 0.1],
      [0.05, NaN, NaN],
      [0, -0.2, 0.1],
    ],
  });
  const rows = historyCsv(history, CHANNELS, 173.8, 173.902)
    .trim()
    .split("\n")
    .map((line) => line.split(","));

  it("name each column once, by its signal and its unit", () => {
    expect(rows[0]).toEqual(["time [s]", "setpoint.theta [deg]", "setpoint.x [m]", "estimate.x [m]", "command.M"]);
  });
  it("hold what is seen, with no more digits than the drone sends, and nothing where nothing came", () => {
    expect(rows.slice(1)).toEqual([
      ["173.896", "5.729578", "0", "0.05", "0"],
      ["173.9", "5.729578", "0.1", "", "-0.2"],
    ]);
  });
});
