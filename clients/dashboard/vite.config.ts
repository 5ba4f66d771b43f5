import { defineConfig } from "vite";

// The build goes into the Python package, which serves it at "/".
export default defineConfig({
  base: "./",
  build: { outDir: "../../service/plumbline/api/dashboard", emptyOutDir: true, target: "es2022" },
  server: { proxy: { "/v1": { target: "http://127.0.0.1:8000", ws: true } } },
});
