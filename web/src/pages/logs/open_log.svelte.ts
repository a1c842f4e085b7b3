// A log that is open: what it holds, the part of it that is looked at, and the time of its replay.

import type { Format, LoggedStep, LogFacts, LogView } from "../../api/logs";
import { logFacts, logReplay, logSteps, logView } from "../../api/logs";
import { LineView } from "../../chart/views.svelte";
import { isThinned, panels, spliced, type Panel } from "./curves";
import { ownPlots } from "./own_plots.svelte";
import { advance, Replay } from "./replay";

const LOUD = ["emergency", "alert", "critical", "error", "warning"];
export const POINTS = 4000;
const PAUSE_MS = 150;

export class OpenLog {
  facts = $state.raw<LogFacts | undefined>();
  whole = $state.raw<LogView | undefined>();
  readonly curves = new FinerCurves(
    async (window) => panels(await logView(this.name, window, POINTS, ownPlots.panels), [], ownPlots.panels.length),
    () => this.span,
  );
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
  /** Time [s] in the log that is shown as 0. */
  readonly zero = $derived(ownPlots.fromZero || this.span[0] > 1e8 ? this.span[0] : 0); // beyond it stands Unix time
  readonly view = new LineView(
    () => this.span,
    false,
    () => this.zero,
  );
  /** Time of the 3-D view: the pointer on a plot, or the replay. */
  readonly now = $derived(this.plays ? this.time : (this.view.pointer ?? this.time));

  /** Changes of parameters and messages. */
  readonly marks = $derived.by(() => {
    const { changes = [], texts = [] } = this.facts ?? {};
    const marks: { time: number; kind: string; label: string }[] = [
      ...changes.map(([time, name, value]) => ({ time, kind: "change", label: `${name} set to ${value}` })),
      ...texts.map(([time, severity, label]) => ({ time, kind: LOUD.includes(severity) ? "loud" : "said", label })),
    ];
    return marks.filter(({ time }) => time === this.inside(time)).sort((a, b) => a.time - b.time);
  });

  private frame = 0;

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
      await this.plot();
      this.facts = facts;
      if (Number.isFinite(at)) this.seek(at);
      else this.time = facts.span[0];
      const [steps, replay] = await Promise.all([logSteps(this.name), logReplay(this.name)]);
      this.steps = steps;
      this.replay = new Replay(replay);
    } catch (failure) {
      this.failure = failure;
    }
  }

  /** Load the plots of the whole log. */
  async plot(): Promise<void> {
    const own = ownPlots.panels;
    this.whole = await logView(this.name, undefined, POINTS, own);
    this.curves.show(panels(this.whole, [], own.length));
    void this.curves.look(this.view.range());
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

/** Plots with more points of the visible range, which `ask` requests; `span` is the range of all data. */
export class FinerCurves {
  shown = $state.raw<readonly Panel[]>([]);
  private all: readonly Panel[] = [];
  /** Range of the request on its way, or of the next one. */
  private wanted: readonly [number, number] | undefined;

  constructor(
    private readonly ask: (window: readonly [number, number]) => Promise<Panel[]>,
    private readonly span: () => readonly [number, number],
  ) {}

  show(all: readonly Panel[]): void {
    this.all = this.shown = all;
  }

  /** Load more points of the visible range, again while it changes. */
  async look(range: readonly [number, number]): Promise<void> {
    const busy = this.wanted !== undefined;
    this.wanted = range;
    for (let ready = busy; !ready; ready = this.wanted === range) {
      await new Promise((done) => setTimeout(done, PAUSE_MS));
      const [low, high] = (range = this.wanted);
      const [start, end] = this.span();
      const { all } = this;
      if ((low <= start && high >= end) || !isThinned(all, POINTS)) {
        this.shown = all;
        continue;
      }
      const margin = 0.5 * (high - low);
      try {
        const part = await this.ask([low - margin, high + margin]);
        if (this.all === all) this.shown = merged(all, part);
      } catch {
        // What is shown stays: it is the same part, with fewer points.
      }
    }
    if (!busy) this.wanted = undefined;
  }
}

/** Put finer curves in place; the panels stay the same. */
function merged(all: readonly Panel[], part: readonly Panel[]): Panel[] {
  return all.map((one) => ({
    ...one,
    series: one.series.map((curve) => {
      const finer = part.find((other) => other.key === one.key)?.series.find((other) => other.label === curve.label);
      return finer ? spliced(curve, finer) : curve;
    }),
  }));
}
