const KEPT = 4096;

/** Delays from the server to the screen [ms] of the last frames. */
export class Latency {
  private readonly waits = new Float64Array(KEPT);
  private count = 0;

  /** Note that rows sent at Unix time `sent` [s] were drawn now. */
  note(sent: number): void {
    if (!Number.isFinite(sent)) return;
    this.waits[this.count % KEPT] = performance.timeOrigin + performance.now() - sent * 1000;
    this.count += 1;
  }

  get drawn(): number {
    return this.count;
  }

  quantile(share: number): number {
    const sorted = this.waits.slice(0, Math.min(this.count, KEPT)).sort();
    return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))]! : NaN;
  }

  /** Return the median of the newest frames [ms]. */
  recent(count = 50): number {
    const from = Math.max(0, this.count - count);
    const waits: number[] = [];
    for (let k = from; k < this.count; k += 1) waits.push(this.waits[k % KEPT]!);
    return waits.sort((a, b) => a - b)[waits.length >> 1] ?? NaN;
  }

  clear(): void {
    this.count = 0;
  }
}

export const latency = new Latency();
Object.assign(globalThis, { twodofLatency: latency }); // for who measures from outside
