export type Theme = "light" | "dark" | "system";

const KEPT = "twodof-theme";

class CurrentTheme {
  now = $state<Theme>("system");

  constructor() {
    const kept = localStorage.getItem(KEPT);
    this.choose(kept === "light" || kept === "dark" ? kept : "system");
  }

  choose(theme: Theme): void {
    this.now = theme;
    const { dataset } = document.documentElement;
    if (theme === "system") {
      localStorage.removeItem(KEPT);
      delete dataset["theme"];
    } else localStorage.setItem(KEPT, (dataset["theme"] = theme));
  }
}

export const theme = new CurrentTheme();
