import type { History } from "./history";
import type { Channel } from "./kinds";
import { figure, quantity } from "./numbers";
import { channelExtent } from "./draw/painter";

export function valueAt(history: History, channel: Channel, time: number): number {
  return history.held(channel.column, history.nearest(time)) * (channel.factor ?? 1);
}

/** Describe the values at a time for a screen reader. */
export function spoken(history: History, channels: readonly Channel[], time: number): string {
  if (!history.length) return "no data yet";
  const values = channels.map((one) => `${one.label} ${quantity(valueAt(history, one, time), one.unit)}`);
  return `at ${figure(time)} s: ${values.join(", ")}`;
}

/** Describe the visible range for a screen reader. */
export function summary(history: History, channels: readonly Channel[], low: number, high: number): string {
  if (!history.length) return "No data yet.";
  const parts = channels.map((one) => {
    const [least, greatest] = channelExtent(history, [one], low, high);
    if (!Number.isFinite(least)) return `${one.label}: nothing.`;
    const last = valueAt(history, one, Math.min(high, history.newest));
    return `${one.label}: from ${figure(least)} to ${figure(greatest)}, at the end ${quantity(last, one.unit)}.`;
  });
  return `${figure(high - low)} s. ${parts.join(" ")}`;
}
