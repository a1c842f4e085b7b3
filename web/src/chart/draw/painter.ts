import type uPlot from "uplot";
import type { Extent, Pyramid } from "./pyramid";

/** What of a column's samples is drawn: for each pixel column the rows that fall on it. */
export interface Columns {
  count: number;
  /** Canvas x of pixel column k. */
  place: Float64Array;
  /** Rows edge[k] to edge[k + 1] - 1 fall on it. */
  edge: Float64Array;
}

/** Room for the widest plot: 4 k at two device pixels a pixel, and one. */
const WIDEST = 8193;

export function room(): Columns {
  return { count: 0, place: new Float64Array(WIDEST), edge: new Float64Array(WIDEST) };
}

/** Find the rows of each pixel column. Columns stand on multiples of their width, so a moving curve does not flicker. */
export function columnsOf(u: uPlot, rowAt: (x: number) => number, into: Columns): void {
  const { left, width } = u.bbox;
  const { min = 0, max = 1 } = u.scales["x"] ?? {};
  const count = Math.min(WIDEST - 1, Math.max(1, Math.round(width / devicePixelRatio)) + 1);
  const step = (max! - min!) / (count - 1);
  const start = Math.floor(min! / step) * step;
  for (let k = 0; k <= count; k += 1) {
    const x = start + k * step;
    into.edge[k] = rowAt(x);
    if (k < count) into.place[k] = left + ((x + step / 2 - min!) / (max! - min!)) * width;
  }
  into.count = count;
}

const extent: Extent = { low: 0, high: 0 };

/** The path of a column through `columns`: from least to greatest of each pixel column, with holes where NaN is. */
export function bucketPath(columns: Columns, column: Pyramid, toY: (value: number) => number): Path2D {
  const path = new Path2D();
  let drawing = false;
  let before = NaN;
  for (let k = 0; k < columns.count; k += 1) {
    const from = columns.edge[k]!;
    const to = columns.edge[k + 1]!;
    if (from >= to) continue;
    column.extent(from, to, extent);
    if (extent.low !== extent.low) {
      drawing = false;
      continue;
    }
    const x = columns.place[k]!;
    const low = toY(extent.low);
    const high = toY(extent.high);
    const lowFirst = drawing ? Math.abs(low - before) < Math.abs(high - before) : true;
    const [one, two] = lowFirst ? [low, high] : [high, low];
    if (drawing) path.lineTo(x, one);
    else path.moveTo(x, one);
    if (one !== two || !drawing) path.lineTo(x, two);
    before = two;
    drawing = true;
  }
  return path;
}

/** The path through each sample from `from` to `to` - 1, with holes where NaN is. */
export function samplePath(
  from: number,
  to: number,
  toX: (row: number) => number,
  toY: (row: number) => number,
): Path2D {
  const path = new Path2D();
  let drawing = false;
  for (let row = from; row < to; row += 1) {
    const y = toY(row);
    if (y !== y) {
      drawing = false;
      continue;
    }
    if (drawing) path.lineTo(toX(row), y);
    else path.moveTo(toX(row), y);
    drawing = true;
  }
  return path;
}
