import { messageOf } from "../api/client";
import { cancelJob, jobResult, type Job } from "../api/jobs";

/** Job of the server as a component shows it: progress, result or failure. */
export class BackgroundJob<T> {
  /** Latest report of the job; undefined before the start. */
  now = $state.raw<Job<T> | undefined>(undefined);
  result = $state.raw<T | undefined>(undefined);
  failure = $state("");
  running = $state(false);
  private readonly left = new AbortController();

  /** Start the job and wait for its end. Returns its result, or undefined if it failed or was cancelled. */
  async run(start: () => Promise<Job<T>>): Promise<T | undefined> {
    [this.running, this.failure, this.result] = [true, "", undefined];
    try {
      this.now = await start();
      if (this.left.signal.aborted) void this.cancel();
      this.result = await jobResult(this.now, (one) => (this.now = one), this.left.signal);
    } catch (failure) {
      this.failure = messageOf(failure);
    } finally {
      this.running = false;
    }
    return this.result;
  }

  async cancel(): Promise<void> {
    if (this.now?.state !== "running") return;
    await cancelJob(this.now.id).catch((failure: unknown) => (this.failure = messageOf(failure)));
  }

  /** Cancel the job when its component goes. A job that can no longer be cancelled is still waited for. */
  leave = (): void => {
    if (this.now?.bound) return;
    this.left.abort();
    void this.cancel();
  };
}
