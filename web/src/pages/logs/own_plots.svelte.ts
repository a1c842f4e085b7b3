// The user's own plots of logs, and how time is counted, kept in this browser.

const KEPT = "twodof-log-plots";

class OwnPlots {
  /** Names of the signals of each plot. */
  panels = $state.raw<readonly (readonly string[])[]>([]);
  /** Show the usual plots below the own ones. */
  usual = $state(true);
  /** Count time from the start of each log. */
  fromZero = $state(false);

  constructor() {
    try {
      Object.assign(this, JSON.parse(localStorage.getItem(KEPT) ?? "{}"));
    } catch {
      // Written by another version, or by hand: it is kept anew.
    }
  }

  change(change: Partial<Pick<OwnPlots, "panels" | "usual" | "fromZero">>): void {
    const { panels, usual, fromZero } = Object.assign(this, change);
    localStorage.setItem(KEPT, JSON.stringify({ panels, usual, fromZero }));
  }

  /** Put a signal into plot `at`, a new one behind the last, or take it out. */
  toggle(at: number, signal: string): void {
    const now = this.panels[at] ?? [];
    const next = now.includes(signal) ? now.filter((one) => one !== signal) : [...now, signal];
    this.change({ panels: [...this.panels.slice(0, at), next, ...this.panels.slice(at + 1)] });
  }
}

export const ownPlots = new OwnPlots();
