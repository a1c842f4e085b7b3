// Notices when this page stood still (a tab put to sleep, a lid closed) and when the computer's clock was set.

/** Time [s] that the page stood still, or by which the clock was set. */
export type ClockEvent = { kind: "stood still" | "clock set"; seconds: number };

const STOOD_STILL_S = 5;
const CLOCK_SET_S = 2;

/** Comparison of a monotonic clock with one that may be set. */
export class ClockWatch {
  private counted: number;
  private told: number;

  constructor(
    private readonly counts: () => number = () => performance.now(),
    private readonly tells: () => number = () => Date.now(),
  ) {
    this.counted = counts();
    this.told = tells();
  }

  /** Return what happened since the last call, whether or not `performance.now` stands still with the page. */
  look(): ClockEvent | undefined {
    const [counted, told] = [this.counts(), this.tells()];
    const passed = (counted - this.counted) / 1000;
    const jumped = (told - this.told) / 1000 - passed;
    this.counted = counted;
    this.told = told;
    if (Math.abs(jumped) > CLOCK_SET_S) return { kind: "clock set", seconds: jumped };
    if (passed > STOOD_STILL_S) return { kind: "stood still", seconds: passed };
    return undefined;
  }
}
