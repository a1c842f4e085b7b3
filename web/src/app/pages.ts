import type { Component } from "svelte";

/** A page: its name in links, its label, and its code, which is loaded when it is first opened. */
export interface Page {
  name: string;
  label: string;
  load: () => Promise<{ default: Component }>;
  /** It is offered only where there are several drones. */
  several?: boolean;
}

/** The same promise each time: what the link says besides the page's name must not build the page anew. */
function once(load: Page["load"]): Page["load"] {
  let found: ReturnType<Page["load"]> | undefined;
  return () => (found ??= load().catch((failure: unknown) => ((found = undefined), Promise.reject(failure))));
}

export const PAGES: readonly Page[] = [
  { name: "fly", label: "Fly", load: once(() => import("../pages/fly/FlyPage.svelte")) },
  { name: "tune", label: "Tune", load: once(() => import("../pages/tune/TunePage.svelte")) },
  { name: "diagram", label: "Diagram", load: once(() => import("../pages/diagram/DiagramPage.svelte")) },
  { name: "identify", label: "Identify", load: once(() => import("../pages/identify/IdentifyPage.svelte")) },
  { name: "logs", label: "Logs", load: once(() => import("../pages/logs/LogsPage.svelte")) },
  {
    name: "drones",
    label: "All drones",
    load: once(() => import("../pages/drones/DronesPage.svelte")),
    several: true,
  },
];
