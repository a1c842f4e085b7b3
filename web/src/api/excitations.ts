import { get, send } from "./client";
import type { Excitation, Loop } from "./drones";

/** A ready-made excitation: the paper's or the course's. */
export interface Preset {
  name: string;
  text: string;
  loop: Loop;
  /** What it is flown with; 0: the motors turn by the moment alone. */
  thrust: number;
  rings: boolean;
  excitation: Excitation;
}

/** The motion that the library predicts; SI, one value a time. */
export interface PredictedMotion {
  time: number[];
  theta: number[];
  x: number[];
  M: number[];
  /** Largest pitch and where the stop is [rad]. */
  pitch: number;
  pitch_stop: number;
  /** Farthest place and where the stop is [m]. */
  rail: number;
  rail_stop: number;
  /** What the failsafe would do, in words, "" for nothing, and when [s]. */
  failsafe: string;
  failsafe_at: number | null;
  /** What predicts it: the identified model or the rig. */
  by: string;
}

export interface ExcitationPreview {
  /** In its final form, to be flown. */
  excitation: Excitation;
  unit: string;
  duration: number;
  peak: number;
  time: number[];
  value: number[];
  motion: PredictedMotion | null;
  /** Why there is no motion. */
  why: string;
}

/** From where it is predicted. */
export interface PreviewAsked {
  excitation: Excitation;
  loop: Loop;
  thrust?: number;
  drone: number;
  /** Where the cart stands [m]. */
  x: number;
}

export const listPresets = () => get<Preset[]>("excitations");
export const previewExcitation = (asked: PreviewAsked) => send<ExcitationPreview>("POST", "excitations/preview", asked);
