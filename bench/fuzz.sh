#!/usr/bin/env bash
# Runs every fuzz target for so many seconds, one after the other; needs nightly Rust and
# cargo-fuzz. Ends with 1 if any crashed. bench/fuzz.sh [SECONDS] [TARGET ...]
set -uo pipefail
cd "$(dirname "$0")/.."
seconds=${1:-60}
shift || true
targets=("$@")
if [ ${#targets[@]} -eq 0 ]; then
  mapfile -t targets < <(cargo +nightly fuzz list | grep -v '^seeds$')
fi
cargo +nightly run --quiet --manifest-path fuzz/Cargo.toml --bin seeds || exit 1
failed=0
for target in "${targets[@]}"; do
  echo "== $target"
  nice -n 10 cargo +nightly fuzz run "$target" -- \
    -max_total_time="$seconds" -rss_limit_mb=2048 -malloc_limit_mb=1024 -timeout=20 -max_len=65536 -print_final_stats=1 \
    2>&1 | tail -n 25 || failed=1
done
exit "$failed"
