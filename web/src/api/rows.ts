// The binary message of the telemetry socket: rows of one subscription, little-endian, see `readRows`.

/** Rows of one subscription. */
export interface Rows {
  id: number;
  /** Drone time [s]. */
  time: Float64Array<ArrayBuffer>;
  columns: Float32Array<ArrayBuffer>[];
  /** Rows dropped so far because this page reads too slowly. */
  dropped: number;
  /** Unix time of the server [s]. */
  sent: number;
}

const ROWS = 1;
const HEADER_BYTES = 24;

/**
 * Reads u8 kind = 1, u8, u16 id, u32 rows n, u32 dropped, u32, f64 Unix time [s], f64[n] drone time [s], float32[n] for
 * each column. Answers undefined for what is not such a message, as a later server may send others.
 */
export function readRows(data: ArrayBuffer): Rows | undefined {
  if (data.byteLength < HEADER_BYTES) return undefined;
  const view = new DataView(data);
  const count = view.getUint32(4, true);
  const rest = data.byteLength - HEADER_BYTES - 8 * count;
  if (view.getUint8(0) !== ROWS || rest < 0 || (count > 0 && rest % (4 * count) !== 0)) return undefined;
  const width = count > 0 ? rest / (4 * count) : 0;
  const start = HEADER_BYTES + 8 * count;
  return {
    id: view.getUint16(2, true),
    time: new Float64Array(data, HEADER_BYTES, count),
    columns: Array.from({ length: width }, (_, k) => new Float32Array(data, start + 4 * count * k, count)),
    dropped: view.getUint32(8, true),
    sent: view.getFloat64(16, true),
  };
}
