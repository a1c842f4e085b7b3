import type { Series } from "../kinds";
import { Pyramid } from "./pyramid";

/** A curve of a static plot, made ready to be drawn fast however long it is. */
export class Curve {
  readonly last: number;
  readonly y: Pyramid;
  readonly low: Pyramid | undefined;
  readonly high: Pyramid | undefined;

  constructor(readonly series: Series) {
    this.last = Math.min(series.x.length, series.y.length);
    this.y = filled(series.y, this.last);
    this.low = series.band && filled(series.band.low, this.last);
    this.high = series.band && filled(series.band.high, this.last);
  }

  /** The first sample at or after `x`. */
  rowAt(x: number): number {
    let low = 0;
    let high = this.last;
    while (low < high) {
      const middle = (low + high) >>> 1;
      if (this.series.x[middle]! < x) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** y at `x`, straight between samples; NaN outside. */
  at(x: number): number {
    const row = this.rowAt(x);
    if (row >= this.last || (row === 0 && this.series.x[0] !== x)) return NaN;
    if (this.series.x[row] === x) return this.series.y[row]!;
    const [x0, x1] = [this.series.x[row - 1]!, this.series.x[row]!];
    const [y0, y1] = [this.series.y[row - 1]!, this.series.y[row]!];
    return y0 + ((y1 - y0) * (x - x0)) / (x1 - x0);
  }
}

function filled(values: ArrayLike<number>, count: number): Pyramid {
  const pyramid = new Pyramid(Math.max(1, count));
  for (let k = 0; k < count; k += 1) pyramid.put(k, values[k]!);
  return pyramid;
}

/** Least and greatest x of some curves; 0 to 1 where there is none. */
export function xRange(curves: readonly Curve[], log: boolean): [number, number] {
  let [low, high] = [Infinity, -Infinity];
  for (const { series, last } of curves) {
    if (!last) continue;
    const first = log ? (series.x.find((x) => x > 0) ?? Infinity) : series.x[0]!;
    low = Math.min(low, first);
    high = Math.max(high, series.x[last - 1]!);
  }
  return low < high ? [low, high] : log ? [0.1, 10] : Number.isFinite(low) ? [low - 0.5, low + 0.5] : [0, 1];
}
