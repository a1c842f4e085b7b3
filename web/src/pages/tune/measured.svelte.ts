import { identificationChoices } from "../../api/identification";
import { logSummary } from "../../api/logs";
import { telemetry } from "../../api/telemetry";
import { measuredSteps, type MeasuredStep, type ParameterRow } from "../../api/tuning";
import { History } from "../../chart/history";
import { STEP_COLUMNS, StepWatch, type FlownStep } from "../../chart/step_watch";
import { keepHistory } from "../../state/live_panels.svelte";
import { flown } from "../logs/words";
import { shown } from "./draft";

const RATE_HZ = 250;
const LOOK_MS = 300;
const SHOWN = 4;
const NAMED = 3;
/** Smallest step [rad]; below it is mostly noise. */
const LEAST = 0.035;

/** Response from 0 to the goal; theta [rad]. */
interface ScaledStep {
  label: string;
  time: readonly number[];
  theta: readonly number[];
}

/** Steps of theta, named by the gains in which they differ: flown while the page is open, or of the latest log. */
export class MeasuredSteps {
  shown = $state(true);
  private live = $state.raw<readonly FlownStep[]>([]);
  private logged = $state.raw<readonly MeasuredStep[]>([]);
  private log = $state("");
  private readonly history = new History([...new Set(STEP_COLUMNS)]);
  private readonly watch = new StepWatch(this.history);
  /** Values of the parameters, as the page shows them, by the start of the step that was flown with them [s]. */
  private values: ReadonlyMap<number, ReadonlyMap<string, string>> = new Map();

  constructor(
    private readonly drone: number,
    private readonly rows: () => readonly ParameterRow[],
  ) {}

  /** Start; returns a function that stops it. */
  start(): () => void {
    const stop = keepHistory(this.history, this.drone, RATE_HZ);
    const events = telemetry.onEvent((event) => {
      if (event.event === "log") void this.read(event.name);
    });
    const timer = setInterval(() => {
      const rows = this.rows().filter((row) => row.same_as === "");
      const now = new Map(rows.map((row) => [row.label, shown(row.value, row.unit)]));
      this.live = this.watch.update();
      this.values = new Map(this.live.map(({ time }) => [time, this.values.get(time) ?? now]));
    }, LOOK_MS);
    // Without a log there is nothing to lay over the prediction, and the text says so.
    const latest = identificationChoices().then(({ flights: [log] }) => (log ? this.read(log) : undefined));
    latest.catch(() => undefined);
    return () => (stop(), events(), clearInterval(timer));
  }

  scaled(goal: number): ScaledStep[] {
    if (!this.shown) return [];
    const large = (step: FlownStep): boolean => Math.abs(step.after - step.before) >= LEAST;
    const steps = this.latest(this.live.filter((step) => step.loop.loop === "theta" && large(step)));
    if (steps.length > 0)
      return steps.map((step) => ({
        label: this.labelOf(step, steps),
        time: step.response.since,
        theta: step.response.share.map((share) => share * goal),
      }));
    return this.logged.slice(-SHOWN).map((step) => ({
      label: `flown at ${step.at.toFixed(1)} s`,
      time: step.time,
      theta: step.theta.map((value) => value * goal),
    }));
  }

  /** Return the steps to show: the latest, half of them of the gains before if there are others. */
  private latest(steps: readonly FlownStep[]): readonly FlownStep[] {
    const sets = new Map<string, FlownStep[]>();
    for (const step of steps.toReversed()) {
      const gains = String([...(this.values.get(step.time) ?? [])]);
      sets.set(gains, [...(sets.get(gains) ?? []), step]);
    }
    const shown = [...sets.values()].slice(0, 2).flatMap((one) => one.slice(0, sets.size > 1 ? SHOWN / 2 : SHOWN));
    return shown.sort((a, b) => a.time - b.time);
  }

  private labelOf(step: FlownStep, steps: readonly FlownStep[]): string {
    const differ = [...(this.values.get(step.time) ?? [])].filter(([name, value]) =>
      steps.some((other) => (this.values.get(other.time)?.get(name) ?? value) !== value),
    );
    const gains = differ.slice(0, NAMED).map(([name, value]) => `${name} ${value}, `);
    return `${gains.join("")}flown at ${step.time.toFixed(1)} s`;
  }

  get text(): string {
    if (this.live.some((step) => step.loop.loop === "theta")) return "flown just now";
    return this.logged.length > 0 ? `from ${this.log}` : "none flown yet: press Arm, then the steps below";
  }

  private async read(name: string): Promise<void> {
    try {
      // Scaled to 1, so that another goal needs no further question.
      const { steps } = await measuredSteps(this.drone, name, 0.5);
      if (steps.length === 0) return;
      const summary = await logSummary(name);
      this.log = "span" in summary ? `${name}: ${flown(summary)}` : name;
      this.logged = steps.map((step) => ({ ...step, theta: step.theta.map((value) => value / 0.5) }));
    } catch {
      // A log of something else.
    }
  }
}
