import { defineConfig } from "vite";

const rolldownOptions = {
  external: ["module"], // MuJoCo imports it in Node only
  checks: { pluginTimings: false },
};

export default defineConfig({
  base: "./", // the page works in any folder of a server
  logLevel: "warn",
  build: { target: "es2022", chunkSizeWarningLimit: 1500, reportCompressedSize: false, license: { fileName: "licences.md" }, rolldownOptions },
  worker: { format: "es", rolldownOptions },
  optimizeDeps: { exclude: ["@mujoco/mujoco"] },
});
