// Notices when this page stood still (a tab put to sleep, a lid closed) and when the computer's clock was set.

/** What was noticed: how long the page stood still, or by how much the clock was set; [s]. */
export type ClockEvent = { kind: "stood still" | "clock set"; seconds: number };

/** Timers of a hidden tab come once a minute at the worst, without its having stood still for the user. */
const STOOD_STILL_S = 5;
const CLOCK_SET_S = 2;

/** Compares two clocks each time `look` is called: one that only counts, and one that may be set. */
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

  /** What has happened since the last look. `performance.now` may stand still with the page, or go on: both are seen. */
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
