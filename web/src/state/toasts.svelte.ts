import { ApiError } from "../api/client";

export interface Toast {
  id: number;
  kind: "info" | "good" | "warn" | "bad";
  text: string;
  remedy: string;
}

const STAYS_MS = 6000;
const MOST = 4;

/** Visible messages; bad ones stay until they are closed. */
export const toasts = $state<{ now: Toast[] }>({ now: [] });

let count = 0;

/** Show a message; the same text is shown once. */
export function toast(text: string, kind: Toast["kind"] = "info", remedy = ""): number {
  const id = ++count;
  const others = toasts.now.filter((one) => one.text !== text);
  toasts.now = [...others, { id, kind, text, remedy }].slice(-MOST);
  if (kind === "info" || kind === "good") setTimeout(() => putAway(id), STAYS_MS);
  return id;
}

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
