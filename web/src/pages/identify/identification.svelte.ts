import { messageOf } from "../../api/client";
import {
  fitLog,
  flyExperiment,
  identificationChoices,
  planExperiment,
  stopFlight,
  type Choices,
  type ExperimentRow,
  type FitView,
  type FlownExperiment,
  type Plan,
} from "../../api/identification";
import { cancelJob, jobResult, type Job } from "../../api/jobs";
import type { Excitation } from "../../api/drones";
import { experimentAsked, fitAsked, latestOf } from "./asked";

const MOST_TRIES = 3;

export interface Running {
  doing: string;
  job: string;
  fraction: number;
  text: string;
  /** A flight is stopped, a computation is cancelled. */
  flight: boolean;
}

export interface FitChoice {
  log: string;
  kind: string;
  structure: string;
  impulse: string;
  others: readonly string[];
  window: [number, number] | undefined;
  disturbance: string;
}

function seed(): number {
  return Math.floor(Math.random() * 2 ** 31);
}

/** State of the page from the choice of an experiment to the fit. */
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
      this.choices = await identificationChoices();
      if (this.choice.log === "") this.chooseLog(this.choices.flights[0] ?? "");
    } catch (failure) {
      this.failed(failure);
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
    const kind = latestOf([log], "impulse", this.names)
      ? "impulse"
      : latestOf([log], "doublet", this.names)
        ? "doublet"
        : "";
    this.choice = {
      ...this.choice,
      log,
      kind,
      impulse: kind === "doublet" ? impulse : "",
      window: undefined,
      others: [],
    };
  }

  async makePlan(drone: number | undefined, rehearse: boolean): Promise<void> {
    const asked = this.asked();
    if (asked === undefined || this.running) return;
    this.plan = undefined;
    const doing = rehearse ? "Rehearsing on the virtual rig" : "Planning";
    await this.run(
      doing,
      () => planExperiment(asked, drone, rehearse),
      false,
      (plan) => (this.plan = plan),
    );
  }

  /** Fly the experiment; `since` is the reason of a repetition. */
  async fly(drone: number, since = ""): Promise<boolean> {
    const asked = this.asked();
    if (asked === undefined) return false;
    return this.run(
      `Flying ${asked.name}${since && ` again: ${since}`}`,
      () => flyExperiment(asked, drone, seed()),
      true,
      async (flown) => {
        this.flown = flown;
        await this.load();
        this.chooseLog(flown.log);
      },
    );
  }

  async makeFit(): Promise<boolean> {
    if (this.running) return false;
    this.fit = undefined;
    let job = "";
    const started = async () => {
      const made = await fitLog(fitAsked(this.choice));
      job = made.id;
      return made;
    };
    return this.run("Identifying", started, false, (found) => (this.fit = { job, view: found.view }));
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

  async stop(): Promise<void> {
    const { running } = this;
    this.stopped = true;
    // Before the server has told the job's number it is stopped as soon as that is known.
    if (running === undefined || running.job === "") return;
    try {
      await (running.flight ? stopFlight(running.job) : cancelJob(running.job));
    } catch (failure) {
      this.failed(failure);
    }
  }

  private stopped = false;

  private asked() {
    const row: ExperimentRow | undefined = this.experiment;
    return row === undefined ? undefined : experimentAsked(row, this.own);
  }

  /** Run a job; returns whether it succeeded. */
  private async run<T>(
    doing: string,
    start: () => Promise<Job<T>>,
    flight: boolean,
    done: (result: T) => unknown,
  ): Promise<boolean> {
    if (this.running !== undefined) return false;
    this.failure = "";
    this.stopped = false;
    this.running = { doing, job: "", fraction: 0, text: "", flight };
    let told = false;
    try {
      const result = await jobResult(await start(), (job) => {
        this.running = { doing, job: job.id, fraction: job.fraction, text: job.text, flight };
        if (this.stopped && !told) {
          told = true;
          void this.stop();
        }
      });
      if (result === undefined) return false;
      await done(result);
      return true;
    } catch (failure) {
      this.failed(failure);
      return false;
    } finally {
      this.running = undefined;
    }
  }

  private failed(failure: unknown): void {
    this.failure = messageOf(failure);
  }
}

export const identification = new Identification();
