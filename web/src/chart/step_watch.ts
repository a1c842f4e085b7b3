import type { LoggedStep } from "../api/logs";
import { CONTROL_LOOPS, type ControlLoop } from "../loops";
import type { History } from "./history";
import { HELD, meanSettling, peakMoment, stepFigures, WINDOW } from "./step_metrics";
import type { Response, Step, StepFigures } from "./step_metrics";

const LOOPS = CONTROL_LOOPS.filter((one) => one.loop !== "M");
const wanted = ({ loop }: ControlLoop): string => `setpoint.${loop}`;
const follows = ({ loop }: ControlLoop): string => `estimate.${loop}`;

/** Columns that `StepWatch` reads. */
export const STEP_COLUMNS = [
  "state.mode",
  "safety.action",
  "command.M",
  ...LOOPS.flatMap((one) => [wanted(one), follows(one)]),
];

/** Flown step; the current one is not `over`. */
export interface FlownStep extends Step {
  loop: ControlLoop;
  figures: StepFigures;
  peakMoment: number;
  over: boolean;
  /** Number of responses of which `figures.settling` is that of the mean. */
  averaged: number;
  /** Changes of parameters before it, in this flight: only steps under the same parameters are averaged. */
  changes: number;
  response: Response;
}

interface Level {
  value: number;
  /** First row. */
  row: number;
  time: number;
}

/** Detector of set-point steps in a history. */
export class StepWatch {
  private steps: FlownStep[] = [];
  private read = 0;
  private restarts = 0;
  private run = new Map<ControlLoop, Level>();
  private held = new Map<ControlLoop, Level>();

  constructor(
    private readonly history: History,
    private readonly kept = 50,
  ) {}

  /** Return the steps so far; the same array if nothing changed. */
  update(): readonly FlownStep[] {
    const { history } = this;
    if (history.restarts !== this.restarts) this.clear();
    for (let row = Math.max(this.read, history.first); row < history.last; row += 1) {
      for (const loop of LOOPS) this.level(loop, row);
    }
    const fresh = this.read !== history.last;
    this.read = history.last;
    if (fresh && this.steps.some((step) => !step.over))
      this.steps = settled(this.steps.map((step) => (step.over ? step : this.measured(step, step.end))));
    return this.steps;
  }

  clear(): void {
    this.steps = [];
    this.run.clear();
    this.held.clear();
    this.read = this.history.first;
    this.restarts = this.history.restarts;
  }

  private level(loop: ControlLoop, row: number): void {
    const value = this.history.column(wanted(loop))?.at(row) ?? NaN;
    const time = this.history.time(row);
    let run = this.run.get(loop);
    if (run === undefined || run.value !== value) {
      run = { value, row, time };
      this.run.set(loop, run);
    }
    if (!this.follows(loop, row)) this.end(loop, time);
    const before = this.held.get(loop);
    if (before === run || time - run.time < HELD || !Number.isFinite(value)) return;
    this.held.set(loop, run);
    if (before === undefined || before.value === value) return;
    // The mode counts as it was at the step, and for as long as it takes to know that it is one.
    if (!this.follows(loop, run.row) || !this.follows(loop, run.row - 1) || !this.follows(loop, row)) return;
    this.end(loop, run.time);
    const figures = stepFigures([], [], before.value, value);
    const found = { loop, time: run.time, before: before.value, after: value, end: Infinity };
    const changes = this.history.changes.filter((one) => one <= run.time).length;
    const response = { since: [], share: [], length: 0 };
    const step = { ...found, figures, peakMoment: NaN, over: false, averaged: 1, changes, response };
    this.steps = [...this.steps, step].slice(-this.kept);
  }

  /** Return whether the loop follows the set-point that was asked for, and not that of the failsafe. */
  private follows(loop: ControlLoop, row: number): boolean {
    const mode = this.history.column("state.mode");
    const action = this.history.column("safety.action")?.at(row) ?? 0;
    return !(action > 0) && (mode === undefined || (row >= this.history.first && mode.at(row) === loop.mode));
  }

  /** End the current step of a loop. */
  private end(loop: ControlLoop, time: number): void {
    const open = (step: FlownStep): boolean => step.loop === loop && !step.over;
    if (this.steps.some(open))
      this.steps = settled(
        this.steps.map((step) => (open(step) ? { ...this.measured(step, time), over: true } : step)),
      );
  }

  private measured(step: FlownStep, end: number): FlownStep {
    const { history } = this;
    const until = Math.min(end, step.time + WINDOW[step.loop.loop]!);
    const [times, moments, since, values]: [number[], number[], number[], number[]] = [[], [], [], []];
    const response = history.column(follows(step.loop));
    const moment = history.column("command.M");
    for (let row = history.rowAt(step.time); row < history.last && history.time(row) <= until; row += 1) {
      times.push(history.time(row));
      moments.push(moment?.at(row) ?? NaN);
      const value = response?.at(row) ?? NaN;
      // x and v come at 100 Hz: not every row has them.
      if (Number.isNaN(value)) continue;
      since.push(history.time(row) - step.time);
      values.push(value);
    }
    if (values.length < 2) return { ...step, end };
    const figures = stepFigures(since, values, step.before, step.after);
    // The next level counts from its first row, which is known only once it was held.
    const over = until < Math.min(end, history.newest - HELD);
    const now = { ...step, end: over || end < Infinity ? until : end };
    const share = values.map((value) => (value - step.before) / (step.after - step.before));
    const length = Math.min(until, history.newest) - step.time;
    return { ...now, figures, peakMoment: peakMoment(times, moments, now), over, response: { since, share, length } };
  }
}

/** Give the steps of a loop under the same parameters the settling of their mean response; a step under way its own. */
function settled(steps: readonly FlownStep[]): FlownStep[] {
  return steps.map((step) => {
    if (!step.over) return { ...step, averaged: 1 };
    const group = steps.filter((one) => one.over && one.loop === step.loop && one.changes === step.changes);
    const { settling, averaged } = meanSettling(group.map((one) => one.response));
    return { ...step, figures: { ...step.figures, settling }, averaged };
  });
}

/** Return the figures of the latest `most` steps as those of a log, the newest first; one under way is `now`. */
export function latestFigures(steps: readonly FlownStep[], most: number): (LoggedStep & { now: boolean })[] {
  const known = (value: number): number | null => (Number.isFinite(value) ? value : null);
  const latest = steps.slice(-most).reverse();
  return latest.map(({ loop, time, before, after, averaged, over, peakMoment, figures }) => ({
    ...{ loop: loop.name as LoggedStep["loop"], time, before, after, averaged, now: !over },
    ...{ rise_time: known(figures.rise), overshoot: known(figures.overshoot), settling_time: known(figures.settling) },
    ...{ peak: known(figures.peak), peak_moment: known(peakMoment) },
  }));
}
