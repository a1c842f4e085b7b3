import { identificationChoices } from "../../api/identification";
import { telemetry } from "../../api/telemetry";
import { measuredSteps, type MeasuredStep } from "../../api/tuning";
import { History } from "../../chart/history";
import { STEP_COLUMNS, StepWatch, type FlownStep } from "../../chart/step_watch";
import { scaledStep, type ScaledStep } from "./flown_steps";

const RATE_HZ = 250;
const LOOK_MS = 300;
const SHOWN = 4;

/** Steps of theta: flown while the page is open, or of the latest log. */
export class MeasuredSteps {
  shown = $state(true);
  private live = $state.raw<readonly FlownStep[]>([]);
  private logged = $state.raw<readonly MeasuredStep[]>([]);
  private log = $state("");
  private readonly history = new History([...new Set(STEP_COLUMNS)]);
  private readonly watch = new StepWatch(this.history);

  constructor(private readonly drone: number) {}

  /** Start; returns a function that stops it. */
  start(): () => void {
    const stop = telemetry.subscribe(this.drone, this.history.names, RATE_HZ, (rows) => this.history.append(rows));
    const events = telemetry.onEvent((event) => {
      if (event.event === "log") void this.read(event.name);
    });
    const timer = setInterval(() => (this.live = this.watch.update()), LOOK_MS);
    void this.readLatest();
    return () => {
      stop();
      events();
      clearInterval(timer);
    };
  }

  scaled(goal: number): ScaledStep[] {
    if (!this.shown) return [];
    const steps = this.live.filter((step) => step.loop.loop === "theta");
    if (steps.length > 0)
      return steps
        .slice(-SHOWN)
        .map((step) => scaledStep(this.history, step, goal, `flown at ${step.time.toFixed(1)} s`))
        .filter((step) => step !== undefined);
    return this.logged.slice(-SHOWN).map((step) => ({
      label: `flown at ${step.at.toFixed(1)} s`,
      time: step.time,
      theta: step.theta.map((value) => value * goal),
    }));
  }

  get text(): string {
    if (this.live.some((step) => step.loop.loop === "theta")) return "as they were flown just now";
    return this.logged.length > 0 ? `of ${this.log}` : "none flown yet: set steps of the pitch on the Fly page";
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
