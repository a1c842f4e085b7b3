import type { Excitation } from "./drones";
import { get, send } from "./client";
import type { Job } from "./jobs";

export interface ExperimentRow {
  name: string;
  text: string;
  mode: string;
  unit: string;
  /** Whether the cart is locked. */
  rings: boolean;
  thrust: number;
  hold: number;
  rest: number;
  duration: number;
  excitation: Excitation;
  /** What is identified from it; null for one that tells no model. */
  kind: string | null;
}

export interface Choices {
  experiments: ExperimentRow[];
  /** By kind the names of its own numbers. */
  excitations: Record<string, string[]>;
  limits: Record<string, number>;
  kinds: { name: string; text: string }[];
  structures: string[];
  /** Logs, the newest first. */
  flights: string[];
}

export interface ExperimentAsked {
  name: string;
  excitation?: Excitation;
  hold?: number;
}

export interface PlannedUnknown {
  name: string;
  unit: string;
  value: number;
  sigma: number;
  /** Half the 95 % interval over the value. */
  share: number | null;
  /** Whether the experiment is flown for it. */
  wanted: boolean;
  enough: boolean;
}

export interface Informative {
  enough: boolean;
  trusted?: boolean;
  text: string;
}

export interface Plan {
  experiment: string;
  kind: string;
  rig: string;
  duration: number;
  unknowns: PlannedUnknown[];
  remark: string;
  motion: { time: number[]; theta: number[]; x: number[] };
  pitch_share: number;
  rail_share: number;
  /** How many times as large as with white noise of the sensor alone the deviations are. */
  worse: number;
  rehearsed: { estimates: EstimateRow[]; informative: Informative; remarks?: string[] } | null;
}

export interface FlownExperiment {
  log: string;
  experiment: string;
  rig: string;
  good: boolean;
  reason: string;
  /** Whether a virtual drone stands at its start again, with its rings as they were. */
  put_back: boolean;
  checks: { name: string; passed: boolean; seen: string }[];
}

export interface EstimateRow {
  name: string;
  unit: string;
  /** What it is, in words. */
  text: string;
  value: number;
  sigma: number | null;
  /** The 95 % interval. */
  low: number | null;
  high: number | null;
  /** One record's own: initial states, trims. */
  local: boolean;
  sum: boolean;
  /** What the simple method reads. */
  simple: number | null;
}

export interface OutputCurves {
  name: string;
  unit: string;
  record: string;
  validation: boolean;
  fit_percent: number;
  /** In closed loop: how well model and noise foretell the next sample. The model alone does not know the gusts. */
  fit_percent_ahead: number | null;
  rmse: number;
  time: number[];
  measured: (number | null)[];
  residual: (number | null)[];
  greybox?: (number | null)[];
  simple?: (number | null)[];
}

export interface ResidualTest {
  output: string;
  /** "itself" for whiteness, else the input. */
  against: string;
  lags: number[];
  value: number[];
  bound: number[];
  passed: boolean;
  outside: number;
  allowed: number;
}

export interface FitView {
  experiment: string;
  structure: string;
  log: string;
  inputs: { name: string; unit: string; time: number[]; value: (number | null)[] }[];
  outputs: OutputCurves[];
  tests: ResidualTest[];
  estimates: EstimateRow[];
  held: Record<string, number>;
  /** Mean and standard deviation of what was known of an unknown before the flight. */
  known_before: Record<string, [number, number]>;
  correlation: { labels: string[]; rows: (number | null)[][] };
  disturbance: string;
  /** The robust standard deviations are quoted, since the residuals are not white. */
  robust: boolean;
  informative: Informative;
  remarks: string[];
  simple: Record<string, unknown> | null;
  simple_text: string;
}

export interface FitAsked {
  log: string;
  kind?: string;
  structure: string;
  impulse?: string;
  others: string[];
  window?: [number, number];
  disturbance: string;
}

export const identificationChoices = () => get<Choices>("identification");
export const planExperiment = (experiment: ExperimentAsked, drone: number | undefined, rehearse: boolean) =>
  send<Job<Plan>>("POST", "identification/plan", { experiment, rehearse, ...(drone === undefined ? {} : { drone }) });
/** `seed` is that of a virtual rig's noise. */
export const flyExperiment = (experiment: ExperimentAsked, drone: number, seed: number) =>
  send<Job<FlownExperiment>>("POST", "identification/fly", { experiment, drone, seed });
export const stopFlight = (job: string) => send<unknown>("POST", `identification/fly/${job}/stop`);
export const fitLog = (asked: FitAsked) =>
  send<Job<{ view: FitView; model: Record<string, unknown> }>>("POST", "identification/fit", asked);
