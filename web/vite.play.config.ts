import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig } from "vite";

// Play in one script and one style sheet, which tools/play.py puts into one page: a page that is opened from a folder
// may load no module.
export default defineConfig({
  plugins: [svelte()],
  base: "./",
  build: {
    outDir: "../out/play-build",
    emptyOutDir: true,
    target: "es2022",
    cssCodeSplit: false,
    modulePreload: false,
    rollupOptions: {
      input: "play.html",
      output: {
        format: "iife",
        inlineDynamicImports: true,
        entryFileNames: "play.js",
        assetFileNames: "play[extname]",
      },
    },
  },
});
