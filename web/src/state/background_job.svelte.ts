import { messageOf } from "../api/client";
import { cancelJob, jobResult, type Job } from "../api/jobs";

/** Job of the server as a component shows it: progress, result or failure. */
export class BackgroundJob<T> {
  /** Latest report of the job; undefined before the start. */
  now = $state.raw<Job<T> | undefined>(undefined);
  result = $state.raw<T | undefined>(undefined);
  failure = $state("");
  running = $state(false);
  cancelled = false;
  private readonly left = new AbortController();

  /** `end` cancels the job of an id. */
  constructor(private readonly end: (id: string) => Promise<unknown> = cancelJob) {}

  /** Start the job and wait for its end. Returns its result, or undefined if it failed or was cancelled. */
  async run(start: () => Promise<Job<T>>): Promise<T | undefined> {
    [this.running, this.cancelled, this.failure, this.result] = [true, false, "", undefined];
    try {
      this.now = await start();
      if (this.cancelled) void this.cancel();
      this.result = await jobResult(this.now, (one) => (this.now = one), this.left.signal);
    } catch (failure) {
      this.failure = messageOf(failure);
    } finally {
      this.running = false;
    }
    return this.result;
  }

  /** Cancel the job; before the server has told its id, as soon as that is known. */
  async cancel(): Promise<void> {
    this.cancelled = true;
    if (this.now?.state !== "running") return;
    await this.end(this.now.id).catch((failure: unknown) => (this.failure = messageOf(failure)));
  }

  /** Cancel the job when its component goes. A job that can no longer be cancelled is still waited for. */
  leave = (): void => {
    if (this.now?.bound) return;
    this.left.abort();
    void this.cancel();
  };
}
