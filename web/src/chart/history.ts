import { Pyramid } from "./draw/pyramid";
import { firstRow } from "./numbers";

/** Rows that came together: times [s], one array per column, and when the server sent them, Unix time [s]. */
export interface Rows {
  time: ArrayLike<number>;
  columns: readonly ArrayLike<number>[];
  sent?: number;
}

const ROWS = 1 << 18; // 17 minutes at 250 Hz; 15 columns take 20 MB

/** The slowest signal comes every 14 rows. */
const HELD_ROWS = 100;

/** A time that jumps back by more than this [s] is a restart. */
const RESTARTED = 0.5;

/**
 * The last rows of some columns of a drone, for charts: a ring, so that its memory stays as it is from the first row.
 *
 *     const history = new History(["estimate.theta", "setpoint.theta"]);
 *     subscribe(drone, history.names, 250, (rows) => history.append(rows));
 *
 * Rows are numbered from 0 as they come; `first` to `last` - 1 are there. Charts ask `listen` to learn of new ones.
 */
export class History {
  readonly columns: readonly Pyramid[];
  private readonly times: Float64Array;
  private readonly byName = new Map<string, Pyramid>();
  private readonly listeners = new Set<() => void>();
  private next = 0;
  private begin = 0;
  /** Unix time [s] at which the newest rows were sent. */
  sent = NaN;
  /** Number of restarts of the drone. Earlier rows and changes are dropped. */
  restarts = 0;
  /** Times [s] at which parameters of the drone were changed. */
  changes: number[] = [];

  constructor(
    readonly names: readonly string[],
    readonly capacity = ROWS,
  ) {
    this.times = new Float64Array(capacity);
    this.columns = names.map(() => new Pyramid(capacity));
    names.forEach((name, k) => this.byName.set(name, this.columns[k]!));
  }

  get first(): number {
    return Math.max(this.begin, this.next - this.capacity);
  }

  get last(): number {
    return this.next;
  }

  get length(): number {
    return this.next - this.first;
  }

  get newest(): number {
    return this.length ? this.time(this.next - 1) : NaN;
  }

  get oldest(): number {
    return this.length ? this.time(this.first) : NaN;
  }

  time(row: number): number {
    return this.times[row % this.capacity]!;
  }

  column(name: string): Pyramid | undefined {
    return this.byName.get(name);
  }

  /** Append rows. A row that is not newer than the last one is ignored. */
  append({ time, columns, sent = NaN }: Rows): void {
    for (let k = 0; k < time.length; k += 1) {
      const now = time[k]!;
      if (this.length && !(now > this.newest)) {
        if (!(now < this.newest - RESTARTED)) continue;
        this.begin = this.next;
        this.restarts += 1;
        this.changes = [];
      }
      this.times[this.next % this.capacity] = now;
      for (let c = 0; c < this.columns.length; c += 1) this.columns[c]!.put(this.next, columns[c]?.[k] ?? NaN);
      this.next += 1;
    }
    this.sent = sent;
    for (const tell of this.listeners) tell();
  }

  /** Note that parameters of the drone have changed at `time` [s], by default now. */
  noteChange(time = this.newest): void {
    if (Number.isFinite(time)) this.changes.push(time);
  }

  /** Return the first row at or after `time` [s]. */
  rowAt(time: number): number {
    return firstRow(this.first, this.next, (row) => !(this.time(row) < time));
  }

  nearest(time: number): number {
    if (!this.length) return -1;
    const row = this.rowAt(time);
    if (row >= this.next) return this.next - 1;
    if (row === this.first) return row;
    return time - this.time(row - 1) < this.time(row) - time ? row - 1 : row;
  }

  /** Return the latest value of a column up to `row`; a slow signal is not in every row. */
  held(name: string, row = this.next - 1): number {
    const column = this.byName.get(name);
    for (let at = row; column && at >= Math.max(this.first, row - HELD_ROWS); at -= 1) {
      const value = column.at(at);
      if (!Number.isNaN(value)) return value;
    }
    return NaN;
  }

  /** Call `tell` after each `append`. Returns a function that ends it. */
  listen(tell: () => void): () => void {
    this.listeners.add(tell);
    return () => this.listeners.delete(tell);
  }
}
