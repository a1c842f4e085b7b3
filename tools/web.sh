#!/usr/bin/env bash
# The browser page of web/: `tools/web.sh PYTHON build` builds it into src/twodof/lab/page, `... check` looks at its types
# and its format, `... test` runs its unit tests, `... play` builds what tools/play.py makes the page Play of. The packages
# are those of web/package-lock.json, each held against the hash written there, no script of theirs run. Node.js is the
# system's where it is 20.19 or newer, else the wheel that requirements/node.txt pins, put beside PYTHON. A build is quick
# and silent when nothing in web/ has changed.
set -euo pipefail
python=${1:?"usage: tools/web.sh PYTHON build|check|test|play"}
cd "$(dirname "$0")/../web"
page=../src/twodof/lab/page

sources() {
    find . -path ./node_modules -prune -o -type f -print0 | sort -z | xargs -0 sha256sum | sha256sum
}
if [[ $2 == build && -f $page/index.html && $(cat $page/built-from 2>/dev/null) == "$(sources)" ]]; then
    exit 0
fi
new_enough() { node -e 'const [a, b] = process.versions.node.split("."); process.exit(a * 100 + +b >= 2019 ? 0 : 1)'; }
node_is_there() { command -v node && command -v npm && new_enough; }
if ! node_is_there >/dev/null 2>&1; then
    PATH=$(dirname "$python"):$PATH
    export PATH
    if ! node_is_there >/dev/null 2>&1; then
        echo "web: no Node.js of 20.19 or newer: installing the wheel that requirements/node.txt pins"
        (cd .. && "$python" -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/node.txt)
    fi
fi
# Two that begin at once, such as the tests of two processes, install once.
exec 9<package-lock.json
flock -w 900 9
if ! cmp -s package-lock.json node_modules/installed-lock.json; then
    echo "web: installing the packages of web/package-lock.json"
    timeout 600 npm ci --ignore-scripts --legacy-peer-deps --no-audit --no-fund --loglevel=error >/dev/null
    cp package-lock.json node_modules/installed-lock.json
fi
flock -u 9
case $2 in
build)
    npx --no-install vite build --logLevel warn
    sources >$page/built-from
    echo "web: the page is built. Start a drone and its page by: .venv/bin/twodof up --open"
    ;;
check)
    npx --no-install svelte-check --tsconfig ./tsconfig.json --fail-on-warnings --output human
    npx --no-install prettier --check --log-level warn .
    ;;
play) npx --no-install vite build --config vite.play.config.ts --logLevel error ;;
test) npx --no-install vitest run ;;
*)
    echo "tools/web.sh: $2 is not build, check, test or play" >&2
    exit 2
    ;;
esac
