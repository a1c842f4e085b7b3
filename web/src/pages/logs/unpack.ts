// Numbers as the server packs them: little-endian, in base 64.

const bytes = (text: string): ArrayBuffer => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;

export const float32s = (text: string): Float32Array => new Float32Array(bytes(text));
export const float64s = (text: string): Float64Array => new Float64Array(bytes(text));

/** Return a staircase through held samples. */
export function staircase(time: Float64Array, value: Float32Array): { x: Float64Array; y: Float32Array } {
  const count = Math.max(0, 2 * time.length - 1);
  const [x, y] = [new Float64Array(count), new Float32Array(count)];
  for (let k = 0; k < time.length; k += 1) {
    x[2 * k] = time[k]!;
    y[2 * k] = value[k]!;
    if (k + 1 < time.length) {
      x[2 * k + 1] = time[k + 1]!;
      y[2 * k + 1] = value[k]!;
    }
  }
  return { x, y };
}
