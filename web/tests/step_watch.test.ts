// The cases are Python's: tests/web/test_page_code.py writes them to the file that it names, and runs this.
import { describe, expect, it } from "vitest";
import { History } from "../src/chart/history";
import { StepWatch } from "../src/chart/step_watch";

interface Found {
  loop: string;
  time: number;
  before: number;
  after: number;
  rise_time: number | null;
  settling_time: number | null;
  overshoot: number;
  peak: number;
  peak_time: number;
  peak_moment: number;
  averaged: number;
}
interface Case {
  name: string;
  /** A column that comes less often than the rows has null in some. */
  columns: Record<string, (number | null)[]>;
  time: number[];
  /** Times at which parameters changed. */
  changes: number[];
  found: Found[];
}

const file = import.meta.env["VITE_TWODOF_STEPS"] as string | undefined;
const read = async (path: string): Promise<Case[]> =>
  ((await import(/* @vite-ignore */ path)) as { default: Case[] }).default;
const cases = file === undefined ? [] : await read(file);

/** Feeds rows as they come over the socket: some at a time, the watch asked in between. */
function watched(one: Case, batch: number): StepWatch {
  const names = Object.keys(one.columns);
  const history = new History(names, 1 << 14);
  const watch = new StepWatch(history);
  one.changes.forEach((time) => history.noteChange(time));
  for (let k = 0; k < one.time.length; k += batch) {
    const columns = names.map((name) => one.columns[name]!.slice(k, k + batch).map((value) => value ?? NaN));
    history.append({ time: one.time.slice(k, k + batch), columns });
    watch.update();
  }
  return watch;
}

describe.skipIf(cases.length === 0)("the figures of steps as they happen", () => {
  it.each(cases.flatMap((one) => [1, 13, 5000].map((batch) => [one.name, batch, one] as const)))(
    "are those that Python reads from the log: %s, %i rows at a time",
    (_, batch, one) => {
      const steps = watched(one, batch).update();
      expect(steps.map((step) => step.loop.name)).toEqual(one.found.map((found) => found.loop));
      steps.forEach((step, k) => {
        const found = one.found[k]!;
        const pairs: [number, number | null][] = [
          [step.time, found.time],
          [step.before, found.before],
          [step.after, found.after],
          [step.figures.rise, found.rise_time],
          [step.figures.settling, found.settling_time],
          [step.figures.overshoot, found.overshoot],
          [step.figures.peak, found.peak],
          [step.peakMoment, found.peak_moment],
          [step.averaged, found.averaged],
        ];
        // The same operations on the same doubles; numpy may add in another order, so the last digits may differ.
        for (const [here, there] of pairs) {
          if (there === null) expect(here).toBeNaN();
          else expect(here).toBeCloseTo(there, 11);
        }
      });
    },
  );
});
