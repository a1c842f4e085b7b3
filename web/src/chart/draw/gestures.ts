import type uPlot from "uplot";
import { TimeView, type View } from "../views.svelte";

const STEP = 0.8; // of a turn of the wheel, or of a press of +
const CLICK = 4; // pixels that a click may move

/**
 * Handle pointers on a plot: drag pans, Shift and drag zooms to the marked range, two fingers and the wheel zoom, a click
 * sets or removes a cursor, a double click resets the view. On a static plot the wheel needs a click before.
 */
export function pointers(u: uPlot, view: () => View, keep: AbortSignal): void {
  const over = u.over;
  const down = new Map<number, number>();
  let mode: "pan" | "mark" | "pinch" | "" = "";
  let start = 0;
  let far = 0;
  let seen = view().range();
  const on = <K extends keyof HTMLElementEventMap>(name: K, what: (event: HTMLElementEventMap[K]) => void): void =>
    over.addEventListener(name, what, { signal: keep, passive: false });
  const at = (clientX: number): number => clientX - over.getBoundingClientRect().left;
  const share = (x: number): number => x / over.clientWidth;

  over.style.touchAction = "pan-y";
  on("pointerdown", (event) => {
    if (event.button !== 0) return;
    over.setPointerCapture(event.pointerId);
    down.set(event.pointerId, at(event.clientX));
    start = at(event.clientX);
    far = 0;
    seen = view().range();
    mode = down.size === 2 ? "pinch" : event.shiftKey ? "mark" : "pan";
  });
  on("pointermove", (event) => {
    const before = down.get(event.pointerId);
    if (before === undefined) return;
    const now = at(event.clientX);
    down.set(event.pointerId, now);
    far = Math.max(far, Math.abs(now - start));
    if (mode === "pinch") {
      const [one = 0, two = 1] = [...down.values()];
      const other = one === now ? two : one;
      const wide = Math.abs(now - other);
      if (wide > 8) view().zoom(Math.abs(before - other) / wide, u.posToVal((now + other) / 2, "x"));
    } else if (mode === "mark") {
      u.setSelect(
        { left: Math.min(start, now), width: Math.abs(now - start), top: 0, height: over.clientHeight },
        false,
      );
    } else if (far > CLICK) view().pan(share(start - now), seen);
  });
  const up = (event: PointerEvent): void => {
    if (!down.delete(event.pointerId)) return;
    const now = at(event.clientX);
    if (mode === "mark") {
      u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      const ends = [u.posToVal(Math.min(start, now), "x"), u.posToVal(Math.max(start, now), "x")] as const;
      if (far > CLICK) view().setRange(...ends);
    } else if (mode === "pan" && far <= CLICK && event.type === "pointerup") view().pin(u.posToVal(now, "x"));
    mode = "";
  };
  on("pointerup", up);
  on("pointercancel", up);
  on("dblclick", () => view().reset());
  on("wheel", (event) => {
    const taken = view() instanceof TimeView || event.ctrlKey;
    if (!taken && !u.root.closest("[data-plot]")?.contains(document.activeElement)) return;
    event.preventDefault();
    if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) view().pan(share(event.deltaX));
    else view().zoom(event.deltaY > 0 ? 1 / STEP : STEP, u.posToVal(at(event.clientX), "x"));
  });
}

/** Help text of the keys. */
export const KEYS =
  "Left and right move the cursor, with Shift they pan; plus and minus zoom; Enter sets or removes a cursor; " +
  "Home shows all, End the newest; Escape clears; Space pauses a live plot.";

/** Handle a key on a plot. Returns whether the plot uses it. */
export function key(view: View, event: KeyboardEvent): boolean {
  if (event.altKey || event.ctrlKey || event.metaKey) return false;
  const [low, high] = view.range();
  const middle = view.log ? Math.sqrt(low * high) : (low + high) / 2;
  const at = view.pointer ?? middle;
  const step = event.repeat ? 0.02 : 0.01;
  const move = (way: number): void => {
    if (event.shiftKey) view.pan(0.1 * way);
    else view.pointer = Math.min(high, Math.max(low, view.moved(at, way * step)));
  };
  const acts: Readonly<Record<string, () => unknown>> = {
    ArrowLeft: () => move(-1),
    ArrowRight: () => move(1),
    "+": () => view.zoom(STEP, at),
    "=": () => view.zoom(STEP, at),
    "-": () => view.zoom(1 / STEP, at),
    Home: () => view.whole(),
    End: () => view.reset(),
    Enter: () => view.pin(at),
    Escape: () => Object.assign(view, { pins: [], pointer: null }),
    ...(view instanceof TimeView && { " ": () => view.togglePause() }),
  };
  const act = acts[event.key];
  if (act === undefined) return false;
  act();
  event.preventDefault();
  return true;
}
