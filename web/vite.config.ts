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
    reportCompressedSize: true,
  },
  server: {
    proxy: { "/api": { target: "http://127.0.0.1:8080", ws: true } },
  },
});
