import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { toast, toasts } from "../src/state/toasts.svelte";

describe("a message", () => {
  beforeEach(() => void vi.useFakeTimers());
  afterEach(() => void vi.useRealTimers());

  it.each(["info", "good", "warn", "bad"] as const)("leaves by itself, but not while it is read: %s", (kind) => {
    toast("Something happened.", kind);
    toasts.read = true;
    vi.advanceTimersByTime(60_000);
    expect(toasts.now).toHaveLength(1);
    toasts.read = false;
    vi.advanceTimersByTime(60_000);
    expect(toasts.now).toHaveLength(0);
  });
});
