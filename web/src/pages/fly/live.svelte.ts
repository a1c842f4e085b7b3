import { request } from "../../api/client";
import { telemetry } from "../../api/telemetry";
import { History } from "../../chart/history";
import { STEP_COLUMNS } from "../../chart/step_watch";

const TRUTH = ["truth.theta", "truth.x"] as const;
const COLUMNS = [
  ...new Set([
    ...STEP_COLUMNS,
    "estimate.theta",
    "estimate.q",
    "estimate.x",
    "estimate.v",
    "setpoint.theta",
    "setpoint.x",
    "setpoint.thrust",
    "command.M",
    "command.T",
  ]),
];
const RATE_HZ = 250;
const SHOW_MS = 100;

/** Newest values, SI; NaN while unknown. */
export interface Now {
  theta: number;
  q: number;
  x: number;
  v: number;
  M: number;
  T: number;
  /** Index into signals.MODES. */
  mode: number;
  /** Set-points; that of `mode` counts. */
  wanted: { theta: number; q: number; x: number; v: number };
  dropped: number;
}

const NOTHING: Now = {
  theta: NaN,
  q: NaN,
  x: NaN,
  v: NaN,
  M: NaN,
  T: NaN,
  mode: NaN,
  wanted: { theta: NaN, q: NaN, x: NaN, v: NaN },
  dropped: 0,
};

/** Rows of one drone while its page is open. */
export class Live {
  readonly history: History;
  now = $state.raw<Now>(NOTHING);
  private dropped = 0;

  constructor(
    readonly drone: number,
    readonly virtual: boolean,
  ) {
    this.history = new History(virtual ? [...COLUMNS, ...TRUTH] : COLUMNS);
  }

  /** Start; returns a function that stops it. */
  start(): () => void {
    const stop = telemetry.subscribe(this.drone, this.history.names, RATE_HZ, (rows) => {
      this.dropped = rows.dropped;
      this.history.append(rows);
    });
    const timer = setInterval(() => {
      if (this.history.length > 0 && !document.hidden) this.now = this.read();
    }, SHOW_MS);
    return () => {
      stop();
      clearInterval(timer);
    };
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

  private read(): Now {
    const value = (name: string) => this.history.held(name);
    return {
      theta: value("estimate.theta"),
      q: value("estimate.q"),
      x: value("estimate.x"),
      v: value("estimate.v"),
      M: value("command.M"),
      T: value("command.T"),
      mode: value("state.mode"),
      wanted: {
        theta: value("setpoint.theta"),
        q: value("setpoint.q"),
        x: value("setpoint.x"),
        v: value("setpoint.v"),
      },
      dropped: this.dropped,
    };
  }
}
