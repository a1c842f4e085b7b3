// A log that is open: what it holds, the part of it that is looked at, and the time of its replay.

import {
  logFacts,
  logReplay,
  logSteps,
  logView,
  type Format,
  type LoggedStep,
  type LogFacts,
  type LogView,
} from "../../api/logs";
import { LineView } from "../../chart/views.svelte";
import { isThinned, panels, type Panel } from "./curves";
import { advance, Replay } from "./replay";

const POINTS = 2000;
const SETTLES_MS = 150;

export class OpenLog {
  facts = $state.raw<LogFacts | undefined>();
  whole = $state.raw<LogView | undefined>();
  shown = $state.raw<readonly Panel[]>([]);
  steps = $state.raw<{ steps: readonly LoggedStep[]; unclear: string }>({ steps: [], unclear: "" });
  replay = $state.raw<Replay | undefined>();
  failure = $state<unknown>(undefined);
  /** It cannot be read, and is not just being recorded. */
  damaged = $state(false);
  /** Of the server's own folder, so that it may be deleted. */
  ours = $state(false);
  formats = $state.raw<readonly Format[]>([]);
  time = $state(0);
  plays = $state(false);
  speed = $state(1);
  readonly span = $derived<readonly [number, number]>(this.facts?.span ?? [0, 1]);
  readonly view = new LineView(() => this.span);
  /** Time of the 3-D view: the pointer on a plot, or the replay. */
  readonly now = $derived(this.plays ? this.time : (this.view.pointer ?? this.time));

  private all: readonly Panel[] = [];
  private frame = 0;
  private asks = 0;

  constructor(readonly name: string) {}

  async load(at: number): Promise<void> {
    try {
      const facts = await logFacts(this.name);
      this.ours = facts.ours;
      this.formats = facts.formats;
      if (!("span" in facts)) {
        this.damaged = facts.formats.length > 0;
        this.failure = new Error(`${this.name} cannot be read: ${facts.unreadable}`);
        return;
      }
      const view = await logView(this.name, undefined, POINTS);
      this.facts = facts;
      if (Number.isFinite(at)) this.seek(at);
      else this.time = facts.span[0];
      this.whole = view;
      this.all = this.shown = panels(view);
      const [steps, replay] = await Promise.all([logSteps(this.name), logReplay(this.name)]);
      this.steps = steps;
      this.replay = new Replay(replay);
    } catch (failure) {
      this.failure = failure;
    }
  }

  /** Load more points of the visible range. Returns a function that cancels it. */
  look([low, high]: readonly [number, number]): () => void {
    const number = (this.asks += 1);
    const [start, end] = this.span;
    if ((low <= start && high >= end) || !isThinned(this.all, POINTS)) {
      this.shown = this.all;
      return () => {};
    }
    const timer = setTimeout(async () => {
      const margin = 0.25 * (high - low);
      try {
        const part = await logView(this.name, [low - margin, high + margin], POINTS);
        if (number === this.asks) this.shown = merged(this.all, panels(part));
      } catch {
        // What is shown stays: it is the same part, with fewer points.
      }
    }, SETTLES_MS);
    return () => clearTimeout(timer);
  }

  seek(time: number): void {
    this.time = this.inside(time);
    this.view.pointer = this.time;
  }

  play(): void {
    if (this.plays) return;
    if (this.time >= this.span[1]) this.time = this.span[0];
    this.plays = true;
    let last = performance.now();
    const step = (now: number): void => {
      if (!this.plays) return;
      const next = advance(this.time, (now - last) / 1000, this.speed, this.span);
      last = now;
      this.time = this.view.pointer = next.time;
      if (next.over) this.plays = false;
      else this.frame = requestAnimationFrame(step);
    };
    this.frame = requestAnimationFrame(step);
  }

  pause(): void {
    this.plays = false;
    cancelAnimationFrame(this.frame);
  }

  mode(time: number): string {
    return this.whole?.modes.find((band) => time >= band.start && time < band.stop)?.label ?? "";
  }

  private inside(time: number): number {
    return Math.min(this.span[1], Math.max(this.span[0], time));
  }
}

/** Replace curves by finer ones; the panels stay the same. */
function merged(all: readonly Panel[], part: readonly Panel[]): Panel[] {
  return all.map((one) => ({
    ...one,
    series: one.series.map((curve) => {
      const finer = part
        .find((other) => other.label === one.label)
        ?.series.find((other) => other.label === curve.label);
      return finer ?? curve;
    }),
  }));
}
