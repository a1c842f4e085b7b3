export type Theme = "light" | "dark" | "system";

const KEPT = "twodof-theme";

class CurrentTheme {
  now = $state<Theme>(read());

  constructor() {
    show(this.now);
  }

  choose(theme: Theme): void {
    this.now = theme;
    if (theme === "system") localStorage.removeItem(KEPT);
    else localStorage.setItem(KEPT, theme);
    show(theme);
  }
}

function read(): Theme {
  const kept = localStorage.getItem(KEPT);
  return kept === "light" || kept === "dark" ? kept : "system";
}

function show(theme: Theme): void {
  if (theme === "system") delete document.documentElement.dataset["theme"];
  else document.documentElement.dataset["theme"] = theme;
}

export const theme = new CurrentTheme();
