import { request } from "./client";

/** Rows of columns of signals.TOPICS as the server takes them: float64 times, then float32 column by column. */
export function packRows(time: ArrayLike<number>, columns: readonly ArrayLike<number>[]): ArrayBuffer {
  const data = new ArrayBuffer(time.length * (8 + 4 * columns.length));
  new Float64Array(data, 0, time.length).set(time);
  columns.forEach((column, k) => new Float32Array(data, 4 * time.length * (2 + k), time.length).set(column));
  return data;
}

/** The rows as a .mat file with the channels of the drone's own logs. */
export async function matFile(names: readonly string[], rows: ArrayBuffer): Promise<Blob> {
  const answer = await request("POST", `export/mat?columns=${names.join(",")}`, rows);
  return await answer.blob();
}
