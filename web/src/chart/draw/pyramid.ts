/** How many samples, or buckets of the level below, a bucket holds. */
const FAN = 8;
const SHIFT = 3;

export interface Extent {
  low: number;
  high: number;
}

/**
 * Minimum and maximum of any range of a column's last `capacity` samples, in a few dozen steps.
 *
 * Sample k stands at k % capacity; bucket b of level n holds samples b 8^n to (b + 1) 8^n - 1. NaN counts for nothing.
 * The memory is all taken at once: 4 bytes a sample and 1.2 for the buckets.
 */
export class Pyramid {
  readonly values: Float32Array;
  private readonly lows: Float32Array[] = [];
  private readonly highs: Float32Array[] = [];

  constructor(readonly capacity: number) {
    this.values = new Float32Array(capacity).fill(NaN);
    for (let size = FAN; size <= capacity; size *= FAN) {
      // One bucket more than fits: the newest may begin before the oldest has ended.
      const count = Math.ceil(capacity / size) + 1;
      this.lows.push(new Float32Array(count).fill(NaN));
      this.highs.push(new Float32Array(count).fill(NaN));
    }
  }

  /** Append sample `index`. */
  put(index: number, value: number): void {
    this.values[index % this.capacity] = value;
    const rounded = Math.fround(value);
    for (let level = 0, size = FAN; level < this.lows.length; level += 1, size *= FAN) {
      const lows = this.lows[level]!;
      const highs = this.highs[level]!;
      const at = Math.floor(index / size) % lows.length;
      if (index % size === 0) lows[at] = highs[at] = rounded;
      else if (rounded === rounded) {
        if (!(lows[at]! <= rounded)) lows[at] = rounded;
        if (!(highs[at]! >= rounded)) highs[at] = rounded;
      }
    }
  }

  at(index: number): number {
    return this.values[index % this.capacity]!;
  }

  extent(from: number, to: number, into: Extent): void {
    let low = Infinity;
    let high = -Infinity;
    let at = from;
    while (at < to) {
      let level = -1;
      let size = 1;
      while (level + 1 < this.lows.length && at % (size << SHIFT) === 0 && at + (size << SHIFT) <= to) {
        level += 1;
        size <<= SHIFT;
      }
      if (level < 0) {
        const value = this.values[at % this.capacity]!;
        if (value < low) low = value;
        if (value > high) high = value;
      } else {
        const slot = Math.floor(at / size) % this.lows[level]!.length;
        const least = this.lows[level]![slot]!;
        const greatest = this.highs[level]![slot]!;
        if (least < low) low = least;
        if (greatest > high) high = greatest;
      }
      at += size;
    }
    into.low = low <= high ? low : NaN;
    into.high = low <= high ? high : NaN;
  }
}
