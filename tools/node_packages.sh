#!/usr/bin/env bash
# What tests/interop runs in node, into FOLDER (make: .venv/node): the packages of tests/interop/package-lock.json, each
# held against the hash written there, no script of theirs run. Quick and silent when they are there already. Where it
# cannot, it says so in one line and the tests that need them are skipped with that reason; with TWODOF_REQUIRE_TOOLS=1
# or CI=true that is an error instead.
set -euo pipefail
folder=${1:?"usage: tools/node_packages.sh FOLDER"}
wanted=$(dirname "$0")/../tests/interop

if cmp -s "$wanted/package-lock.json" "$folder/installed-lock.json"; then
    exit 0
fi
reason="npm is missing"
if command -v npm >/dev/null; then
    mkdir -p "$folder"
    cp "$wanted/package.json" "$wanted/package-lock.json" "$folder"
    echo "tools: installing node-mavlink into $folder"
    if timeout 600 npm ci --prefix "$folder" --ignore-scripts --legacy-peer-deps --no-audit --no-fund --loglevel=error >/dev/null; then
        cp "$wanted/package-lock.json" "$folder/installed-lock.json"
        exit 0
    fi
    reason="npm could not install it"
fi
if [[ ${TWODOF_REQUIRE_TOOLS:-} == 1 || ${CI:-} == true ]]; then
    echo "tools: node-mavlink missing ($reason), and nothing may be skipped here" >&2
    exit 1
fi
echo "tools: node-mavlink missing ($reason): the tests that need it will be skipped" >&2
