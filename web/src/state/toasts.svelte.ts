import { ApiError } from "../api/client";

export interface Toast {
  id: number;
  kind: "info" | "good" | "warn" | "bad";
  text: string;
  remedy: string;
}

/** A failure takes longer to read. */
const STAYS_MS = { info: 6000, good: 6000, warn: 20_000, bad: 20_000 };
const MOST = 4;

/** Visible messages; none leaves while they are read: while the pointer or the keyboard is on them. */
export const toasts = $state<{ now: Toast[]; read: boolean }>({ now: [], read: false });

let count = 0;

/** Show a message; the same text is shown once. */
export function toast(text: string, kind: Toast["kind"] = "info", remedy = ""): number {
  const id = ++count;
  const others = toasts.now.filter((one) => one.text !== text);
  toasts.now = [...others, { id, kind, text, remedy }].slice(-MOST);
  setTimeout(() => leave(id), STAYS_MS[kind]);
  return id;
}

function leave(id: number): void {
  if (toasts.read) setTimeout(() => leave(id), 1000);
  else putAway(id);
}

export function toastError(failure: unknown): number {
  if (!(failure instanceof ApiError)) return toast(String(failure), "bad");
  if (failure.status === 401) return 0; // the head of the page says it
  return toast(failure.what + (failure.where && ` (${failure.where})`), "bad", failure.remedy);
}

/** Await `work`, or show its failure as a message. Returns whether it succeeded. */
export async function tried(work: () => Promise<unknown>): Promise<boolean> {
  try {
    await work();
    return true;
  } catch (failure) {
    toastError(failure);
    return false;
  }
}

export const putAway = (id: number): void => void (toasts.now = toasts.now.filter((one) => one.id !== id));
