#!/usr/bin/env bash
# The tool chains of the tests over all targets, which no wheel brings: names what is missing and, as root on Debian,
# installs it. Where it cannot, it says so in one line and the tests that need the tool are skipped with that reason;
# with TWODOF_REQUIRE_TOOLS=1 or CI=true that is an error instead, so that continuous integration skips nothing.
set -euo pipefail

# A tool and the Debian packages that bring it.
tools=(
    "gcc gcc libc6-dev"
    "g++ g++"
    "qemu-system-arm qemu-system-arm"
    "arm-none-eabi-gcc gcc-arm-none-eabi libnewlib-arm-none-eabi"
    "node nodejs"
    "npm npm"
    "cppcheck cppcheck"
    "octave-cli octave" # the judge of the MATLAB subset; runs matlab/
    "curl curl" # Octave's requests in matlab/
    "chromium chromium" # tests/web open the page in a real browser: no wheel brings one, and its maker's is a download
)

missing() {
    local row
    for row in "${tools[@]}"; do
        command -v "${row%% *}" >/dev/null || echo "$row"
    done
    if command -v arm-none-eabi-gcc >/dev/null && [[ ! -f $(arm-none-eabi-gcc -print-file-name=libm.a) ]]; then
        echo "newlib libnewlib-arm-none-eabi" # a recommendation of the compiler's package that is easily left out
    fi
}

required() { [[ ${TWODOF_REQUIRE_TOOLS:-} == 1 || ${CI:-} == true ]]; }

mapfile -t absent < <(missing)
if ((${#absent[@]} == 0)); then
    exit 0
fi
packages=$(for row in "${absent[@]}"; do tr ' ' '\n' <<<"${row#* }"; done | sort -u | tr '\n' ' ')
if [[ $(id -u) -eq 0 ]] && command -v apt-get >/dev/null; then
    echo "tools: installing ${packages% }"
    export DEBIAN_FRONTEND=noninteractive
    # Somebody else may be installing or fetching the lists, and a mirror may not answer the first time.
    patience=(-o DPkg::Lock::Timeout=300 -o Acquire::Retries=3)
    for _ in {1..30}; do # that time-out is not for the lock of the lists
        said=$(timeout 900 apt-get "${patience[@]}" update -qq 2>&1) && break
        [[ $said == *"Could not get lock"* ]] || break
        sleep 10
    done
    [[ -z $said ]] || echo "$said" >&2
    timeout 900 apt-get "${patience[@]}" install -y -qq --no-install-recommends $packages >/dev/null ||
        echo "tools: apt-get could not install them" >&2
    mapfile -t absent < <(missing)
fi
if ((${#absent[@]})); then
    names=$(printf '%s, ' "${absent[@]%% *}")
    if required; then
        echo "tools: ${names%, } missing, and nothing may be skipped here: install ${packages% }" >&2
        exit 1
    fi
    echo "tools: ${names%, } missing: the tests that need them will be skipped; install ${packages% }" >&2
fi
