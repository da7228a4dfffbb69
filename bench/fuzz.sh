#!/usr/bin/env bash
# Runs every fuzz target for so many seconds, one after the other; needs nightly Rust and
# cargo-fuzz. Ends with 1 if any crashed.
#
#   bench/fuzz.sh [SECONDS] [TARGET ...]
set -uo pipefail
cd "$(dirname "$0")/.." || exit
seconds=${1:-60}
shift || true
targets=("$@")
if [ ${#targets[@]} -eq 0 ]; then
  mapfile -t targets < <(cargo +nightly fuzz list | grep -v '^seeds$')
fi
# The seeds are built like the targets, so that what they depend on is compiled once.
cargo +nightly fuzz build || exit 1
host=$(rustc +nightly -vV | sed -n 's/^host: //p')
ASAN_OPTIONS=detect_leaks=0 "${CARGO_TARGET_DIR:-fuzz/target}/$host/release/seeds" || exit 1
failed=0
TIMEFORMAT="cpu %U s user, %S s system"
for target in "${targets[@]}"; do
  echo "== $target"
  time nice -n 10 cargo +nightly fuzz run "$target" -- \
    -max_total_time="$seconds" -rss_limit_mb=2048 -malloc_limit_mb=1024 -timeout=20 -max_len=65536 \
    -print_final_stats=1 -print_funcs=0 \
    2>&1 | tail -n 25 || failed=1
done
exit "$failed"
