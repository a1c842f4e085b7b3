// Everything that draws does so in one animation frame, and only when something has changed.

const due = new Set<() => void>();
let asked = 0;

function drawAll(): void {
  asked = 0;
  const now = [...due];
  due.clear();
  for (const draw of now) draw();
}

/** Draws in the next frame, once however often it is asked for. */
export function askFrame(draw: () => void): void {
  due.add(draw);
  if (!asked) asked = requestAnimationFrame(drawAll);
}

/** What is no longer there is not drawn. */
export function forgetFrame(draw: () => void): void {
  due.delete(draw);
}
