import type { Zoomable } from "./draw/gestures";

/** Which part of x a static plot shows; `all` tells where its curves begin and end. */
export class LineView implements Zoomable {
  private part = $state<readonly [number, number] | null>(null);
  pointer = $state<number | null>(null);
  pins = $state<readonly number[]>([]);

  constructor(
    readonly all: () => readonly [number, number],
    readonly log = false,
  ) {}

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

  reset(): void {
    this.part = null;
    this.pins = [];
  }

  whole(): void {
    this.part = null;
  }

  pin(x: number): void {
    this.pins = this.pins.length === 1 ? [...this.pins, x] : [x];
  }
}
