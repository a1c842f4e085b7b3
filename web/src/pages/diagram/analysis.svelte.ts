// Margins and Bode plots: of the diagram, and of the stock controller beside it.
import * as api from "../../api/diagrams";
import { curve, SERIES, type Series } from "../../chart/kinds";
import { BackgroundJob } from "../../state/background_job.svelte";

const WAIT_MS = 600;
const DASH = [6, 4];

class Analysis {
  job = $state.raw(new BackgroundJob<api.Margins>());
  found = $state.raw<api.Margins | undefined>(undefined);

  /** Analyse a diagram in a moment; returns a function that gives it up. */
  ask(text: () => string | Promise<string>, rig: string): () => void {
    const next = new BackgroundJob<api.Margins>();
    const timer = setTimeout(async () => {
      this.job = next;
      this.found = (await next.run(async () => api.startMargins(await text(), rig))) ?? this.found;
    }, WAIT_MS);
    return () => (clearTimeout(timer), next.leave());
  }
}

export const mine = new Analysis();
export const stock = new Analysis();

/** Return the Bode curves of each loop, those of the stock controller dashed. */
export function bodeCurves(what: "gain" | "phase", unit: string, beside: boolean): Series[] {
  const of = ({ found }: Analysis, after: string, more: { dash?: readonly number[] }): Series[] =>
    Object.entries(found?.loops ?? {}).map(([label, { bode }], i) =>
      curve(label + after, "simple", bode.omega, bode[what], unit, { colour: SERIES[i % SERIES.length]!, ...more }),
    );
  return [...of(mine, "", {}), ...(beside ? of(stock, ", stock", { dash: DASH }) : [])];
}
