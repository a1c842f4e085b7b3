/// <reference types="vitest/config" />
import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig } from "vite";

// The page goes into the Python package, which serves it. `vite dev` passes the API on to a server that runs beside it.
export default defineConfig({
  plugins: [svelte()],
  base: "./",
  build: {
    outDir: "../src/twodof/lab/page",
    emptyOutDir: true,
    target: "es2022",
    // The view in three dimensions is one large file, and comes from the reader's own computer.
    chunkSizeWarningLimit: 1500,
    rolldownOptions: { checks: { pluginTimings: false } },
  },
  // A loaded machine takes longer than vitest's 5 s over a flight: only what hangs is to end.
  // One thread without a world of its own for each file takes a third of the processor.
  test: { testTimeout: 120_000, pool: "threads", isolate: false, maxWorkers: 1 },
  server: {
    proxy: { "/api": { target: "http://127.0.0.1:8080", ws: true } },
  },
});
