// A canvas cannot resolve `light-dark(...)`, which the tokens hold; an element can.

const found = new Map<string, string>();
const listeners = new Set<() => void>();
let probe: HTMLElement | undefined;

function changed(): void {
  found.clear();
  for (const tell of listeners) tell();
}

/** Return the present colour of a token of design/tokens.css or, for the scene, of design/base.css. */
export function colour(token: string): string {
  const known = found.get(token);
  if (known !== undefined) return known;
  if (probe === undefined) {
    probe = document.createElement("span");
    probe.hidden = true;
    document.body.append(probe);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
    new MutationObserver(changed).observe(document.documentElement, { attributeFilter: ["data-theme", "style"] });
  }
  probe.style.color = `var(--${token})`;
  const now = getComputedStyle(probe).color;
  found.set(token, now);
  return now;
}

/** Call `tell` when the theme changes. Returns a function that ends it. */
export function onTheme(tell: () => void): () => void {
  colour("ink");
  listeners.add(tell);
  return () => listeners.delete(tell);
}

// Everything that draws does so in one animation frame, and only when something has changed.

const due = new Set<() => void>();
let asked = 0;

function drawAll(): void {
  asked = 0;
  const now = [...due];
  due.clear();
  for (const draw of now) draw();
}

/** Draw once in the next frame. */
export function askFrame(draw: () => void): void {
  due.add(draw);
  if (!asked) asked = requestAnimationFrame(drawAll);
}

export function forgetFrame(draw: () => void): void {
  due.delete(draw);
}
