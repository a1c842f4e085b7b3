import { get, send } from "./client";
import type { Excitation, Loop } from "./drones";

export interface Preset {
  name: string;
  text: string;
  loop: Loop;
  /** 0: the motors turn by the moment alone. */
  thrust: number;
  rings: boolean;
  excitation: Excitation;
}

/** Predicted motion, SI. */
export interface PredictedMotion {
  time: number[];
  theta: number[];
  x: number[];
  /** Largest pitch [rad]. */
  pitch: number;
  pitch_stop: number;
  /** Largest distance from the middle [m]. */
  rail: number;
  rail_stop: number;
  /** Predicted action of the failsafe, "" for none. */
  failsafe: string;
  failsafe_at: number | null;
  by: string;
}

export interface ExcitationPreview {
  excitation: Excitation;
  duration: number;
  time: number[];
  value: number[];
  motion: PredictedMotion | null;
  why: string;
  /** True if the prediction will come later. */
  again: boolean;
}

export interface PreviewRequest {
  excitation: Excitation;
  loop: Loop;
  thrust?: number;
  drone: number;
  x: number;
}

export const listPresets = () => get<Preset[]>("excitations");
/** A prediction takes up to 30 s on a slow computer, behind others that wait. */
export const previewExcitation = (asked: PreviewRequest) =>
  send<ExcitationPreview>("POST", "excitations/preview", asked, 60);
