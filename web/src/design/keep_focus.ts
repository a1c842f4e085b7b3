import { tick } from "svelte";

/**
 * Where the control that was pressed is off or gone by now, the keyboard goes on at the first of these places that can
 * have it. Whoever has gone elsewhere meanwhile stays there.
 */
export async function keepFocus(...places: (HTMLElement | null | undefined)[]): Promise<void> {
  await tick();
  const now = document.activeElement;
  // A control that has just been switched off has it until the next frame.
  if (now !== null && now !== document.body && !now.matches(":disabled")) return;
  places.find((one) => one?.isConnected && !one.matches(":disabled"))?.focus();
}
