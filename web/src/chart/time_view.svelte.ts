import type { Zoomable } from "./draw/gestures";

const SHORTEST = 0.02; // [s]: five samples

/**
 * Which part of the time the charts of a page show, and where their cursors are; shared by all of them.
 *
 * It follows the newest rows until somebody pans or pauses; rows go on being kept. `newest` tells where they end.
 */
export class TimeView implements Zoomable {
  /** Seconds that are seen. */
  span = $state(20);
  /** Where the view ends [s]; null while it follows. */
  private stop = $state<number | null>(null);
  /** Where the pointer or the arrow keys are [s]. */
  pointer = $state<number | null>(null);
  /** Cursors that stay [s], at most two. */
  pins = $state<readonly number[]>([]);
  /** Charts with the same key share the pointer. */
  readonly key = `time-${Math.random().toString(36).slice(2)}`;

  constructor(
    readonly newest: () => number,
    readonly oldest: () => number,
    readonly longest = 1000,
  ) {}

  get follows(): boolean {
    return this.stop === null;
  }

  range(): readonly [number, number] {
    // What has just begun grows from the left, and moves once the view is full.
    const end = this.stop ?? Math.max(this.newest(), this.oldest() + this.span);
    return Number.isFinite(end) ? [end - this.span, end] : [0, this.span];
  }

  setRange(low: number, high: number): void {
    this.span = Math.min(this.longest, Math.max(SHORTEST, high - low));
    this.stop = Math.max(high, this.oldest() || high);
    if (this.stop >= this.newest()) this.stop = null;
  }

  /** Shows `factor` of the time that is seen, around `at`; a view that follows goes on following. */
  zoom(factor: number, at: number): void {
    const [low, high] = this.range();
    const wanted = Math.min(this.longest, Math.max(SHORTEST, this.span * factor));
    const share = (at - low) / (high - low);
    if (this.stop !== null) this.stop = at + (1 - share) * wanted;
    this.span = wanted;
  }

  reset(): void {
    this.stop = null;
    this.pins = [];
  }

  whole(): void {
    this.setRange(this.oldest(), this.newest());
  }

  /** Stands still, or follows again. Nothing is lost meanwhile. */
  togglePause(): void {
    this.stop = this.stop === null ? this.newest() : null;
  }

  /** Sets a cursor: the first, the second, then the first anew. */
  pin(x: number): void {
    this.pins = this.pins.length === 1 ? [...this.pins, x] : [x];
  }
}
