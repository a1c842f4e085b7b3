import { ApiError } from "../api/client";

/** A short message that does not stand where something was done. */
export interface Toast {
  id: number;
  kind: "info" | "good" | "warn" | "bad";
  text: string;
  remedy: string;
}

const STAYS_MS = 6000;
const MOST = 4;

/** The messages that are shown; what is bad stays until it is put away. */
export const toasts = $state<{ now: Toast[] }>({ now: [] });

let count = 0;

/** Shows a message; the same text again is shown once. Answers its number, for `putAway`. */
export function toast(text: string, kind: Toast["kind"] = "info", remedy = ""): number {
  const id = ++count;
  const others = toasts.now.filter((one) => one.text !== text);
  toasts.now = [...others, { id, kind, text, remedy }].slice(-MOST);
  if (kind === "info" || kind === "good") setTimeout(() => putAway(id), STAYS_MS);
  return id;
}

/** Shows what went wrong, with the remedy that the server gives. */
export function toastError(failure: unknown): number {
  if (failure instanceof ApiError) {
    return toast(
      [failure.what, failure.where && `(${failure.where})`].filter(Boolean).join(" "),
      "bad",
      failure.remedy,
    );
  }
  return toast(String(failure), "bad");
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

export function putAway(id: number): void {
  toasts.now = toasts.now.filter((one) => one.id !== id);
}
