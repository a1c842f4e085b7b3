import { CONTROL_LOOPS, type ControlLoop } from "../loops";
import type { History } from "./history";
import { HELD, peakMoment, stepFigures, type Step, type StepFigures } from "./step_metrics";

const LOOPS = CONTROL_LOOPS.filter((one) => one.loop !== "M");
const wanted = ({ loop }: ControlLoop): string => `setpoint.${loop}`;
const follows = ({ loop }: ControlLoop): string => `estimate.${loop}`;

/** Columns that `StepWatch` reads. */
export const STEP_COLUMNS = ["state.mode", "command.M", ...LOOPS.flatMap((one) => [wanted(one), follows(one)])];

/** Flown step; the current one is not `over`. */
export interface FlownStep extends Step {
  loop: ControlLoop;
  figures: StepFigures;
  peakMoment: number;
  over: boolean;
}

/** Longest response to a step [s]. */
const LONGEST = 60;

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
      this.steps = this.steps.map((step) => (step.over ? step : this.measured(step, step.end)));
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
    this.steps = [...this.steps, { ...found, figures, peakMoment: NaN, over: false }].slice(-this.kept);
  }

  private follows(loop: ControlLoop, row: number): boolean {
    const mode = this.history.column("state.mode");
    return mode === undefined || (row >= this.history.first && mode.at(row) === loop.mode);
  }

  /** End the current step of a loop. */
  private end(loop: ControlLoop, time: number): void {
    const open = (step: FlownStep): boolean => step.loop === loop && !step.over;
    if (this.steps.some(open))
      this.steps = this.steps.map((step) => (open(step) ? { ...this.measured(step, time), over: true } : step));
  }

  private measured(step: FlownStep, end: number): FlownStep {
    const { history } = this;
    const until = Math.min(end, step.time + LONGEST);
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
    const over = step.time + LONGEST < history.newest;
    return { ...step, end, figures, peakMoment: peakMoment(times, moments, { ...step, end }), over };
  }
}
