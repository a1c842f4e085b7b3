import { ApiError, get, patiently, send } from "./client";

export interface Job<T> {
  id: string;
  kind: string;
  state: "running" | "done" | "failed" | "cancelled";
  /** 0 to 1. */
  fraction: number;
  text: string;
  /** Time that the last successful job of this kind took [s]. */
  last_s: number | null;
  /** It can no longer be cancelled. */
  bound: boolean;
  result: T | null;
  error: { what: string; where: string; remedy: string } | null;
}

const LOOK_MS = 300;

export const cancelJob = (id: string) => send<Job<unknown>>("DELETE", `jobs/${id}`);

/**
 * Waits for a job that was started, and tells how far it is. Answers its result; raises ApiError with what the server
 * says where it failed, and undefined where it was cancelled or `signal` ended the waiting.
 */
export async function jobResult<T>(
  started: Job<T>,
  onChange: (job: Job<T>) => void = () => {},
  signal?: AbortSignal,
): Promise<T | undefined> {
  let job = started;
  while (job.state === "running") {
    onChange(job);
    await new Promise((done) => setTimeout(done, LOOK_MS));
    if (signal?.aborted) return undefined;
    job = await patiently(
      () => get<Job<T>>(`jobs/${started.id}`),
      () => signal?.aborted ?? false,
    );
  }
  onChange(job);
  if (job.error !== null) throw new ApiError(409, job.error.what, job.error.where, job.error.remedy);
  return job.result ?? undefined;
}
