import { messageOf, patiently } from "../../api/client";
import type { Choices, FitView, FlownExperiment, Plan } from "../../api/identification";
import { fitLog, flyExperiment, identificationChoices, planExperiment, stopFlight } from "../../api/identification";
import type { Job } from "../../api/jobs";
import type { Excitation } from "../../api/drones";
import { BackgroundJob } from "../../state/background_job.svelte";
import { experimentRequest, fitRequest, latestOf, type FitChoice } from "./requests";

const MOST_TRIES = 3;

export interface Running {
  doing: string;
  /** A flight is stopped, a computation is cancelled. */
  flight: boolean;
  job: BackgroundJob<unknown>;
}

function seed(): number {
  return Math.floor(Math.random() * 2 ** 31);
}

export class Identification {
  choices = $state.raw<Choices | undefined>(undefined);
  name = $state("impulse");
  own = $state.raw<Excitation | undefined>(undefined);
  plan = $state.raw<Plan | undefined>(undefined);
  flown = $state.raw<FlownExperiment | undefined>(undefined);
  fit = $state.raw<{ job: string; view: FitView } | undefined>(undefined);
  choice = $state.raw<FitChoice>({
    log: "",
    kind: "",
    structure: "auto",
    impulse: "",
    others: [],
    window: undefined,
    disturbance: "auto",
  });
  running = $state.raw<Running | undefined>(undefined);
  readonly waits = "Another job is running.";
  failure = $state("");
  readonly experiment = $derived(this.choices?.experiments.find((one) => one.name === this.name));
  readonly names = $derived(this.choices?.experiments.map((one) => one.name) ?? []);

  async load(): Promise<void> {
    try {
      this.choices = await patiently(
        identificationChoices,
        () => false,
        (failure) => (this.failure = `${messageOf(failure)}. It is asked again by itself.`),
      );
      this.failure = "";
      if (this.choice.log === "") this.chooseLog(this.choices.flights[0] ?? "");
    } catch (failure) {
      this.failure = messageOf(failure);
    }
  }

  choose(name: string): void {
    this.name = name;
    this.own = undefined;
    this.plan = undefined;
  }

  /** Choose a log, and the experiment that it is named after. */
  chooseLog(log: string): void {
    const impulse = latestOf(this.choices?.flights ?? [], "impulse", this.names) ?? "";
    const kind = ["impulse", "doublet"].find((name) => latestOf([log], name, this.names)) ?? "";
    const own = { log, kind, impulse: kind === "doublet" ? impulse : "", window: undefined, others: [] };
    this.choice = { ...this.choice, ...own };
  }

  async makePlan(drone: number | undefined, rehearse: boolean): Promise<void> {
    const asked = this.asked();
    if (asked === undefined || this.running) return;
    this.plan = undefined;
    const doing = rehearse ? "Rehearsing on the virtual rig" : "Planning";
    const job = new BackgroundJob<Plan>();
    await this.run(doing, job, () => planExperiment(asked, drone, rehearse));
    this.plan = job.result;
  }

  /** Fly the experiment; `since` is the reason of a repetition. */
  async fly(drone: number, since = ""): Promise<boolean> {
    const asked = this.asked();
    if (asked === undefined || this.running) return false;
    const job = new BackgroundJob<FlownExperiment>(stopFlight);
    const doing = `Flying ${asked.name}${since && ` again: ${since}`}`;
    const landed = async (flown: FlownExperiment) => {
      this.flown = flown;
      await this.load();
      this.chooseLog(flown.log);
    };
    await this.run(doing, job, () => flyExperiment(asked, drone, seed()), landed);
    return job.result !== undefined;
  }

  async makeFit(): Promise<void> {
    if (this.running) return;
    this.fit = undefined;
    const job = new BackgroundJob<{ view: FitView }>();
    await this.run("Identifying", job, () => fitLog(fitRequest(this.choice)));
    if (job.result) this.fit = { job: job.now!.id, view: job.result.view };
  }

  /** Fly the impulse for the poles and the doublet for gain and delay, and fit both. */
  async runPitch(drone: number, virtual: boolean): Promise<void> {
    if (this.running) return;
    for (const name of ["impulse", "doublet"]) {
      this.choose(name);
      // A gust may end a flight of a virtual rig; a real drone is looked at before it flies again.
      const tries = virtual ? MOST_TRIES : 1;
      for (let flown = 1, ended = ""; ; flown += 1) {
        if (!(await this.fly(drone, ended))) return;
        ended = this.flown?.reason ?? "";
        if (!ended) break;
        if (this.stopped) return;
        if (flown === tries) {
          const often = tries > 1 ? `${tries} times, and each time it ended early` : "and it ended early";
          this.failure = `The ${name} was flown ${often}: ${ended}. Look at the log, or press Whole pitch run again.`;
          return;
        }
      }
    }
    await this.makeFit();
  }

  stop(): void {
    this.stopped = true;
    void this.running?.job.cancel();
  }

  private stopped = false;

  private asked() {
    return this.experiment && experimentRequest(this.experiment, this.own);
  }

  /** Run a job; that of a flight is running until `landed` has shown what was flown. */
  private async run<T>(
    doing: string,
    job: BackgroundJob<T>,
    start: () => Promise<Job<T>>,
    landed?: (flown: T) => Promise<void>,
  ): Promise<void> {
    [this.failure, this.stopped] = ["", false];
    this.running = { doing, flight: landed !== undefined, job };
    await job.run(landed ? start : () => patiently(start, () => job.cancelled));
    this.failure = job.failure;
    if (job.result !== undefined) await landed?.(job.result);
    this.running = undefined;
  }
}

export const identification = new Identification();
