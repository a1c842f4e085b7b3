import type { Component } from "svelte";

/** Page with its name in links; its code is loaded when it is first opened. */
export interface Page {
  name: string;
  label: string;
  load: () => Promise<{ default: Component }>;
  /** Shown only with several drones. */
  several?: boolean;
}

/** Return the same promise each time, so that a new query does not rebuild the page. */
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
