// A job that a dialog started: how far it is, its result or why there is none; ended when the dialog is closed.
import { cancelJob, jobResult, type Job } from "../../../api/jobs";

export class DialogJob<T> {
  /** How it stands; undefined before it was started. */
  now = $state.raw<Job<T> | undefined>(undefined);
  result = $state.raw<T | undefined>(undefined);
  failure = $state("");
  running = $state(false);
  private readonly left = new AbortController();

  /** Starts it and waits for its end; answers its result, undefined where it failed or was ended. */
  async run(start: () => Promise<Job<T>>): Promise<T | undefined> {
    [this.running, this.failure] = [true, ""];
    try {
      this.now = await start();
      if (this.left.signal.aborted) void this.end();
      this.result = await jobResult(this.now, (one) => (this.now = one), this.left.signal);
    } catch (fault) {
      this.failure = (fault as Error).message;
    } finally {
      this.running = false;
    }
    return this.result;
  }

  /** Ends it; answers whether it could be ended. */
  async end(): Promise<boolean> {
    if (this.now === undefined || this.now.state !== "running") return true;
    return cancelJob(this.now.id).then(
      () => true,
      (refused: unknown) => {
        this.failure = (refused as Error).message;
        return false;
      },
    );
  }

  /** For `onMount`: ends it when the dialog is closed. */
  leave = (): void => {
    if (this.now?.bound) return; // it goes on, and its end is still waited for
    this.left.abort();
    void this.end();
  };
}
