import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig } from "vite";

// The pages for measuring, built apart: `npx vite build --config bench/vite.config.ts --outDir FOLDER`.
export default defineConfig({
  root: new URL(".", import.meta.url).pathname,
  plugins: [svelte({ configFile: "../svelte.config.js" })],
  base: "./",
  build: { emptyOutDir: true, target: "es2022", rollupOptions: { input: ["charts.html", "scene.html"] } },
});
