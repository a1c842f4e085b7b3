import { identificationChoices } from "../../api/identification";
import { telemetry } from "../../api/telemetry";
import { measuredSteps, type MeasuredStep, type ParameterRow } from "../../api/tuning";
import { History } from "../../chart/history";
import { STEP_COLUMNS, StepWatch, type FlownStep } from "../../chart/step_watch";
import { figure } from "../../chart/numbers";
import { keepHistory } from "../../state/live_panels.svelte";
import { scaledStep, type ScaledStep } from "./flown_steps";

const RATE_HZ = 250;
const LOOK_MS = 300;
const SHOWN = 4;
const NAMED = 3;

/** Steps of theta, named by the gains in which they differ: flown while the page is open, or of the latest log. */
export class MeasuredSteps {
  shown = $state(true);
  private live = $state.raw<readonly FlownStep[]>([]);
  private logged = $state.raw<readonly MeasuredStep[]>([]);
  private log = $state("");
  private readonly history = new History([...new Set(STEP_COLUMNS)]);
  private readonly watch = new StepWatch(this.history);
  /** Values of the parameters by the number of their changes in this flight. */
  private values: ReadonlyMap<string, number>[] = [];

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
      this.values[this.history.changes.length] = new Map(rows.map((row) => [row.label, row.value]));
      this.live = this.watch.update();
    }, LOOK_MS);
    void this.readLatest();
    return () => {
      stop();
      events();
      clearInterval(timer);
    };
  }

  scaled(goal: number): ScaledStep[] {
    if (!this.shown) return [];
    const steps = this.live.filter((step) => step.loop.loop === "theta").slice(-SHOWN);
    if (steps.length > 0)
      return steps
        .map((step) => scaledStep(this.history, step, goal, this.labelOf(step, steps)))
        .filter((step) => step !== undefined);
    return this.logged.slice(-SHOWN).map((step) => ({
      label: `flown at ${step.at.toFixed(1)} s`,
      time: step.time,
      theta: step.theta.map((value) => value * goal),
    }));
  }

  private labelOf(step: FlownStep, steps: readonly FlownStep[]): string {
    const own = this.values[step.changes] ?? new Map<string, number>();
    const differ = [...own].filter(([name, value]) =>
      steps.some((other) => (this.values[other.changes]?.get(name) ?? value) !== value),
    );
    const gains = differ.slice(0, NAMED).map(([name, value]) => `${name} ${figure(value, 3)}, `);
    return `${gains.join("")}flown at ${step.time.toFixed(1)} s`;
  }

  get text(): string {
    if (this.live.some((step) => step.loop.loop === "theta")) return "flown just now";
    return this.logged.length > 0 ? `from ${this.log}` : "none flown yet: press Arm, then the steps below";
  }

  private async readLatest(): Promise<void> {
    try {
      const [latest] = (await identificationChoices()).flights;
      if (latest !== undefined) await this.read(latest);
    } catch {
      // Without a log there is nothing to lay over it, and the text says so.
    }
  }

  private async read(name: string): Promise<void> {
    try {
      // Scaled to 1, so that another goal needs no further question.
      const { steps } = await measuredSteps(this.drone, name, 0.5);
      if (steps.length === 0) return;
      this.log = name;
      this.logged = steps.map((step) => ({ ...step, theta: step.theta.map((value) => value / 0.5) }));
    } catch {
      // A log of something else.
    }
  }
}
