import type { History } from "./history";

export const CURSORS = "ABCDEFGH";
const HIT = 0.005; // share of the range
const SHORTEST = 0.02; // [s]: five samples
const LONGEST = 1000; // [s]

/** Visible range of x, pointer and cursors of a plot. Plots with the same view pan and zoom together. */
export abstract class View {
  /** Position of the mouse or of the arrow keys. */
  pointer = $state<number | null>(null);
  /** Cursors A, B and so on. */
  pins = $state<readonly number[]>([]);

  /** `origin` returns the x that is shown as 0. */
  constructor(
    readonly log = false,
    readonly origin = () => 0,
  ) {}

  abstract range(): readonly [number, number];
  abstract setRange(low: number, high: number): void;
  /** Zoom around `at`; a factor below 1 shows less. */
  abstract zoom(factor: number, at: number): void;
  /** Show all data. */
  abstract whole(): void;

  /** Show the initial range without cursors. */
  reset(): void {
    this.pins = [];
  }

  /** Set the next cursor, or remove the one that stands there. */
  pin(x: number): void {
    const near = this.moved(x, HIT) - x;
    const others = this.pins.filter((pin) => Math.abs(pin - x) > near);
    if (others.length < this.pins.length) this.pins = others;
    else if (others.length < CURSORS.length) this.pins = [...others, x];
  }

  /** Return `x` moved by a share of the range. */
  moved(x: number, share: number, [low, high] = this.range()): number {
    return this.log ? x * (high / low) ** share : x + share * (high - low);
  }

  /** Pan from `range` by a share of it. */
  pan(share: number, range = this.range()): void {
    this.setRange(this.moved(range[0], share, range), this.moved(range[1], share, range));
  }
}

/** View of a static plot; `all` returns the range of its data. */
export class LineView extends View {
  private part = $state<readonly [number, number] | null>(null);

  constructor(
    readonly all: () => readonly [number, number],
    log = false,
    origin = () => 0,
  ) {
    super(log, origin);
  }

  range(): readonly [number, number] {
    return this.part ?? this.all();
  }

  setRange(low: number, high: number): void {
    const [least, greatest] = this.all();
    const inside: [number, number] = [Math.max(low, least), Math.min(high, greatest)];
    if (inside[1] > inside[0]) this.part = inside[0] === least && inside[1] === greatest ? null : inside;
  }

  zoom(factor: number, at: number): void {
    const [low, high] = this.range();
    if (this.log) this.setRange(at * (low / at) ** factor, at * (high / at) ** factor);
    else this.setRange(at - (at - low) * factor, at + (high - at) * factor);
  }

  whole(): void {
    this.part = null;
  }

  override reset(): void {
    super.reset();
    this.part = null;
  }
}

/** View of strip charts, in time [s]. It follows the newest rows of the history until it is panned or paused. */
export class TimeView extends View {
  /** Visible seconds. */
  span = $state(20);
  /** End of the range; null while it follows. */
  private stop = $state<number | null>(null);
  /** Charts with the same key show the pointer at the same time. */
  readonly key = `time-${Math.random().toString(36).slice(2)}`;

  constructor(private readonly history: Pick<History, "newest" | "oldest">) {
    super();
  }

  get follows(): boolean {
    return this.stop === null;
  }

  range(): readonly [number, number] {
    // A short history grows from the left, and moves once the view is full.
    const end = this.stop ?? Math.max(this.history.newest, this.history.oldest + this.span);
    return Number.isFinite(end) ? [end - this.span, end] : [0, this.span];
  }

  setRange(low: number, high: number): void {
    this.span = Math.min(LONGEST, Math.max(SHORTEST, high - low));
    this.stop = Math.max(high, this.history.oldest || high);
    if (this.stop >= this.history.newest) this.stop = null;
  }

  /** Zoom around `at`. A view that follows goes on following. */
  zoom(factor: number, at: number): void {
    const [low, high] = this.range();
    const wanted = Math.min(LONGEST, Math.max(SHORTEST, this.span * factor));
    const share = (at - low) / (high - low);
    if (this.stop !== null) this.stop = at + (1 - share) * wanted;
    this.span = wanted;
  }

  whole(): void {
    this.setRange(this.history.oldest, this.history.newest);
  }

  override reset(): void {
    super.reset();
    this.stop = null;
  }

  /** Pause, or follow again. Rows are recorded meanwhile. */
  togglePause(): void {
    this.stop = this.stop === null ? this.history.newest : null;
  }
}
