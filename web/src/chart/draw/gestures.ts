import type uPlot from "uplot";

/** What is seen of x, and what pointers and keys do to it. */
export interface Zoomable {
  pointer: number | null;
  pins: readonly number[];
  readonly log?: boolean;
  range(): readonly [number, number];
  setRange(low: number, high: number): void;
  zoom(factor: number, at: number): void;
  whole(): void;
  reset(): void;
  pin(x: number): void;
  togglePause?(): void;
}

const STEP = 0.8; // of a turn of the wheel, or of a press of +
const CLICK = 4; // pixels that a click may move

/** x after a move by `share` of what is seen. */
function moved(view: Zoomable, x: number, share: number): number {
  const [low, high] = view.range();
  return view.log ? x * (high / low) ** share : x + share * (high - low);
}

function pan(view: Zoomable, share: number): void {
  const [low, high] = view.range();
  view.setRange(moved(view, low, share), moved(view, high, share));
}

/**
 * Pointers on a plot: drag pans, Shift and drag zooms to what is marked, two fingers pinch, the wheel zooms, a click
 * sets a cursor, a double click shows it as it was. `wheelAlways`: also before the plot has been clicked.
 */
export function pointers(u: uPlot, view: () => Zoomable, wheelAlways: () => boolean, keep: AbortSignal): void {
  const over = u.over;
  const down = new Map<number, number>();
  let mode: "pan" | "mark" | "pinch" | "" = "";
  let start = 0;
  let far = 0;
  let seen: readonly [number, number] = [0, 1];
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
    } else if (far > CLICK) {
      const back = share(start - now);
      const [low, high] = seen;
      const log = view().log;
      const to = (x: number): number => (log ? x * (high / low) ** back : x + back * (high - low));
      view().setRange(to(low), to(high));
    }
  });
  const up = (event: PointerEvent): void => {
    if (!down.delete(event.pointerId)) return;
    const now = at(event.clientX);
    if (mode === "mark") {
      u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      const ends = [u.posToVal(Math.min(start, now), "x"), u.posToVal(Math.max(start, now), "x")] as const;
      if (far > CLICK) view().setRange(...ends);
    } else if (mode === "pan" && far <= CLICK && event.type === "pointerup") {
      view().pin(u.posToVal(now, "x"));
    }
    mode = "";
  };
  on("pointerup", up);
  on("pointercancel", up);
  on("dblclick", () => view().reset());
  on("wheel", (event) => {
    if (!wheelAlways() && !event.ctrlKey && !u.root.closest("[data-plot]")?.contains(document.activeElement)) return;
    event.preventDefault();
    if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) pan(view(), share(event.deltaX));
    else view().zoom(event.deltaY > 0 ? 1 / STEP : STEP, u.posToVal(at(event.clientX), "x"));
  });
}

/** What the keys do, for the help beside a plot. */
export const KEYS =
  "Left and right move the cursor, with Shift they pan; plus and minus zoom; Enter sets a cursor; " +
  "Home shows all, End the newest; Escape clears; Space pauses what is live.";

/** A key pressed on a plot; true where it did something. */
export function key(view: Zoomable, event: KeyboardEvent): boolean {
  if (event.altKey || event.ctrlKey || event.metaKey) return false;
  const [low, high] = view.range();
  const middle = view.log ? Math.sqrt(low * high) : (low + high) / 2;
  const at = view.pointer ?? middle;
  const step = event.repeat ? 0.02 : 0.01;
  switch (event.key) {
    case "ArrowLeft":
    case "ArrowRight": {
      const way = event.key === "ArrowLeft" ? -1 : 1;
      if (event.shiftKey) pan(view, 0.1 * way);
      else view.pointer = Math.min(high, Math.max(low, moved(view, at, way * step)));
      break;
    }
    case "+":
    case "=":
      view.zoom(STEP, at);
      break;
    case "-":
      view.zoom(1 / STEP, at);
      break;
    case "Home":
      view.whole();
      break;
    case "End":
      view.reset();
      break;
    case "Enter":
      view.pin(at);
      break;
    case "Escape":
      view.pins = [];
      view.pointer = null;
      break;
    case " ":
      if (view.togglePause === undefined) return false;
      view.togglePause();
      break;
    default:
      return false;
  }
  event.preventDefault();
  return true;
}
