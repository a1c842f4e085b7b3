import type { Excitation } from "./drones";
import { get, send } from "./client";
import type { Job } from "./jobs";

export interface ExperimentRow {
  name: string;
  text: string;
  mode: string;
  rings: boolean;
  duration: number;
  excitation: Excitation;
  /** Model that is identified; null for none. */
  kind: string | null;
}

export interface Choices {
  experiments: ExperimentRow[];
  kinds: { name: string; text: string }[];
  structures: string[];
  flights: string[];
}

export interface ExperimentRequest {
  name: string;
  excitation?: Excitation;
}

export interface PlannedUnknown {
  name: string;
  unit: string;
  value: number;
  sigma: number;
  /** Half the 95 % interval, as a share of the value. */
  share: number | null;
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
  /** Standard deviation relative to that with white sensor noise alone. */
  worse: number;
  rehearsed: { estimates: EstimateRow[]; informative: Informative; remarks?: string[] } | null;
}

export interface FlownExperiment {
  log: string;
  experiment: string;
  good: boolean;
  reason: string;
  put_back: boolean;
  checks: { name: string; passed: boolean; seen: string }[];
}

export interface EstimateRow {
  name: string;
  unit: string;
  text: string;
  value: number;
  sigma: number | null;
  low: number | null;
  high: number | null;
  /** Initial state or trim of one record. */
  local: boolean;
  /** Not estimated. */
  held: boolean;
  sum: boolean;
  simple: number | null;
  /** Value of the virtual rig that flew, if the log names one. */
  truth: number | null;
}

/** Return whether an interval misses the virtual rig's own value; undefined if either is unknown. */
export const missesTruth = ({ low, high, truth }: EstimateRow) =>
  low === null || high === null || truth === null ? undefined : truth < low || high < truth;

export interface OutputCurves {
  name: string;
  unit: string;
  record: string;
  validation: boolean;
  fit_percent: number;
  /** One-step-ahead fit, in closed loop. */
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
  /** Prior mean and standard deviation. */
  prior: Record<string, [number, number]>;
  correlation: { labels: string[]; rows: (number | null)[][] };
  disturbance: string;
  /** Standard deviations are robust, since the residuals are not white. */
  robust: boolean;
  informative: Informative;
  remarks: string[];
  simple: Record<string, unknown> | null;
  simple_text: string;
}

export interface FitRequest {
  log: string;
  kind?: string;
  structure: string;
  impulse?: string;
  others: string[];
  window?: [number, number];
  disturbance: string;
}

export const identificationChoices = () => get<Choices>("identification");
export const planExperiment = (experiment: ExperimentRequest, drone: number | undefined, rehearse: boolean) =>
  send<Job<Plan>>("POST", "identification/plan", { experiment, rehearse, ...(drone === undefined ? {} : { drone }) });
/** `seed` is that of a virtual rig's noise. */
export const flyExperiment = (experiment: ExperimentRequest, drone: number, seed: number) =>
  send<Job<FlownExperiment>>("POST", "identification/fly", { experiment, drone, seed });
export const stopFlight = (job: string) => send<unknown>("POST", `identification/fly/${job}/stop`);
export const fitLog = (asked: FitRequest) =>
  send<Job<{ view: FitView; model: Record<string, unknown> }>>("POST", "identification/fit", asked);
