import { request } from "../../api/client";
import { History } from "../../chart/history";
import { STEP_COLUMNS } from "../../chart/step_watch";
import { keepHistory } from "../../state/live_panels.svelte";

const TRUTH = ["truth.theta", "truth.x"] as const;
const COLUMNS = [...STEP_COLUMNS, "setpoint.thrust", "command.T"];
const RATE_HZ = 250;
const SHOW_MS = 100;

/** Rows of one drone while its page is open. */
export class Live {
  readonly history: History;
  /** Rows that were dropped because this page reads too slowly. */
  dropped = $state(0);
  /** Counter that refreshes the values ten times a second. */
  private beat = $state(0);

  constructor(
    readonly drone: number,
    readonly virtual: boolean,
  ) {
    this.history = new History(virtual ? [...COLUMNS, ...TRUTH] : COLUMNS);
  }

  /** Return the newest value of a column, SI; NaN while it is unknown. */
  readonly value = (column: string): number => (this.beat > 0 ? this.history.held(column) : NaN);

  /** Start; returns a function that stops it. */
  start(): () => void {
    let dropped = 0;
    const stop = keepHistory(this.history, this.drone, RATE_HZ, (rows) => (dropped = rows.dropped));
    const timer = setInterval(() => {
      if (this.history.length === 0 || document.hidden) return;
      this.dropped = dropped;
      this.beat += 1;
    }, SHOW_MS);
    return () => (stop(), clearInterval(timer));
  }

  /** Return the rows from `low` to `high` [s] as a .mat file with the channels of the drone's own logs. */
  async matFile(low: number, high: number, columns: readonly string[]): Promise<Blob> {
    const { history } = this;
    const names = [...new Set(columns)];
    const from = history.rowAt(low);
    const count = Math.max(0, history.rowAt(high) - from);
    const time = Float64Array.from({ length: count }, (_, k) => history.time(from + k));
    // The server takes float64 times, then float32 column by column.
    const data = new ArrayBuffer(count * (8 + 4 * names.length));
    new Float64Array(data, 0, count).set(time);
    names.forEach((name, c) => {
      const column = history.column(name);
      const values = new Float32Array(data, 4 * count * (2 + c), count);
      for (let k = 0; k < count; k += 1) values[k] = column?.at(from + k) ?? NaN;
    });
    return (await request("POST", `export/mat?columns=${names.join(",")}`, data)).blob();
  }
}
