import { get, send } from "./client";
import type { Job } from "./jobs";
import type { Interval } from "./tuning";

/** Saved model. Tuning and design need `pitch`; `why` says what is missing. */
export interface ModelRow {
  name: string;
  /** Unix time [s]. */
  kept: number;
  experiment?: string;
  values: { name: string; value: number; sigma: number | null; unit: string }[];
  pitch: boolean;
  why: string;
  informative?: { enough: boolean; trusted: boolean; text: string } | null;
}

export interface ControllerRequest {
  name: string;
  /** Crossover of the rate loop [rad/s]. */
  crossover: number;
  method: "cascade" | "lqg";
  overwrite: boolean;
}

export interface Designed {
  /** Saved diagram; null if it is not robust. */
  file: string | null;
  design: { gains: { rate: [number, number, number]; attitude: number } } | null;
  robustness: { robust: boolean; text: string };
  figures: Record<string, Interval>;
  goal: number;
  level: number;
  /** Sample time of the bands [s]. */
  period: number;
  bands: Record<"theta", { low: number[]; middle: number[]; high: number[] }>;
}

const at = (name: string) => `models/${encodeURIComponent(name)}`;

export const listModels = () => get<ModelRow[]>("models");
export const keepModel = (job: string, name: string, overwrite = false) =>
  send<ModelRow>("POST", "models", { job, name, overwrite });
export const deleteModel = (name: string) => send<undefined>("DELETE", at(name));
export const designController = (model: string, asked: ControllerRequest) =>
  send<Job<Designed>>("POST", `${at(model)}/controller`, asked);
