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

  /** Return a quantile of the delays of the `newest` frames [ms]. */
  quantile(share: number, newest = KEPT): number {
    const length = Math.min(newest, this.count, KEPT);
    const waits = Float64Array.from({ length }, (_, k) => this.waits[(this.count - 1 - k) % KEPT]!).sort();
    return waits[Math.min(length - 1, Math.floor(share * length))] ?? NaN;
  }

  clear(): void {
    this.count = 0;
  }
}

export const latency = new Latency();
Object.assign(globalThis, { twodofLatency: latency }); // for who measures from outside
