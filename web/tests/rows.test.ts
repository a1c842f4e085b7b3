import { describe, expect, it } from "vitest";
import { readRows } from "../src/api/rows";

/** The message as the contract lays it out. */
function message(id: number, dropped: number, sent: number, time: number[], columns: number[][]): ArrayBuffer {
  const data = new ArrayBuffer(24 + 8 * time.length + 4 * columns.length * time.length);
  const view = new DataView(data);
  view.setUint8(0, 1);
  view.setUint16(2, id, true);
  view.setUint32(4, time.length, true);
  view.setUint32(8, dropped, true);
  view.setFloat64(16, sent, true);
  time.forEach((t, k) => view.setFloat64(24 + 8 * k, t, true));
  columns.flat().forEach((value, k) => view.setFloat32(24 + 8 * time.length + 4 * k, value, true));
  return data;
}

describe("rows from the socket", () => {
  it("hold the drone's time and one array a column", () => {
    const rows = readRows(
      message(
        7,
        3,
        1e9,
        [0.004, 0.008],
        [
          [1, 2],
          [-0.5, NaN],
        ],
      ),
    )!;
    expect([rows.id, rows.dropped, rows.sent]).toEqual([7, 3, 1e9]);
    expect([...rows.time]).toEqual([0.004, 0.008]);
    expect(rows.columns.map((column) => [...column])).toEqual([
      [1, 2],
      [-0.5, NaN],
    ]);
  });
  it("may be none", () => {
    expect(readRows(message(1, 0, 0, [], []))!.time.length).toBe(0);
  });
  it("are refused where the message is cut off, of another kind, or says more than it holds", () => {
    const whole = message(1, 0, 0, [1, 2], [[1, 2]]);
    expect(readRows(whole.slice(0, 23))).toBeUndefined();
    expect(readRows(whole.slice(0, whole.byteLength - 4))).toBeUndefined();
    const huge = whole.slice(0);
    new DataView(huge).setUint32(4, 0xffffffff, true);
    expect(readRows(huge)).toBeUndefined();
    const other = whole.slice(0);
    new DataView(other).setUint8(0, 2);
    expect(readRows(other)).toBeUndefined();
  });
});
