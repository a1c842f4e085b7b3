// A slider gives more values than the network takes: one call is under way, and of those that wait the last is kept.

/** Sender of the newest value, one call at a time. */
export class LatestOnly<Value> {
  private waiting: Value | undefined;
  private busy = false;

  constructor(
    private readonly send: (value: Value) => Promise<unknown>,
    private readonly failed: (failure: unknown) => void,
  ) {}

  give(value: Value): void {
    this.waiting = value;
    if (!this.busy) void this.work();
  }

  clear(): void {
    this.waiting = undefined;
  }

  private async work(): Promise<void> {
    this.busy = true;
    while (this.waiting !== undefined) {
      const value = this.waiting;
      this.waiting = undefined;
      try {
        await this.send(value);
      } catch (failure) {
        // What waited was meant to follow what was refused: it is not sent behind it.
        this.waiting = undefined;
        this.failed(failure);
      }
    }
    this.busy = false;
  }
}
