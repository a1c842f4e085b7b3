// Panels around the sheet that are folded for more room. The browser remembers them.
const KEPT = "twodof-diagram-folded";
export const PANELS = { palette: "Palette", side: "Properties", plots: "Simulation" } as const;
export type PanelName = keyof typeof PANELS;
const NAMES = Object.keys(PANELS) as PanelName[];

class Folds {
  private all = $state.raw<readonly string[]>((localStorage.getItem(KEPT) ?? "").split(","));

  has(name: PanelName): boolean {
    return this.all.includes(name);
  }

  fold(name: PanelName, folded: boolean): void {
    if (this.has(name) !== folded) this.keep(folded ? [...this.all, name] : this.all.filter((one) => one !== name));
  }

  /** Fold all panels, or show all if all are folded. */
  toggleAll(): void {
    this.keep(NAMES.every((name) => this.has(name)) ? [] : NAMES);
  }

  private keep(names: readonly string[]): void {
    this.all = names;
    localStorage.setItem(KEPT, names.join());
  }
}

export const folds = new Folds();
