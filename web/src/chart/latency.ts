const KEPT = 4096;

/** How long rows took from the server to the screen [ms]: the last few thousand frames. */
export class Latency {
  private readonly waits = new Float64Array(KEPT);
  private count = 0;

  /** Rows that the server sent at unix time `sent` [s] have just been drawn. */
  note(sent: number): void {
    if (!Number.isFinite(sent)) return;
    this.waits[this.count % KEPT] = performance.timeOrigin + performance.now() - sent * 1000;
    this.count += 1;
  }

  get drawn(): number {
    return this.count;
  }

  /** The wait that a share of the frames kept to [ms]: `quantile(0.5)` is the median; NaN before the first. */
  quantile(share: number): number {
    const sorted = this.waits.slice(0, Math.min(this.count, KEPT)).sort();
    return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))]! : NaN;
  }

  /** The median of the newest frames, about a second of them [ms]; NaN where none was drawn. */
  recent(count = 50): number {
    const from = Math.max(0, this.count - count);
    const waits: number[] = [];
    for (let k = from; k < this.count; k += 1) waits.push(this.waits[k % KEPT]!);
    return waits.sort((a, b) => a - b)[waits.length >> 1] ?? NaN;
  }

  /** Begins anew. */
  clear(): void {
    this.count = 0;
  }
}

/** That of the strip charts of this page. */
export const latency = new Latency();
Object.assign(globalThis, { twodofLatency: latency }); // for who measures from outside
