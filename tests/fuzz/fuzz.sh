#!/usr/bin/env bash
# Builds the fuzzers (clang) and runs them: ./run fuzz [TARGET] [SECONDS | RUNSx], one core at low priority.
# Without a target all of them, one after the other. What is found lies in build/fuzz/found.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
binary=build/fuzz/bin/fuzz

if ! command -v clang++ >/dev/null; then
  echo "fuzz: clang++ is missing; install it with: apt-get install clang" >&2
  exit 1
fi
cmake --preset fuzz >/dev/null
cmake --build --preset fuzz

names=$("$binary" || true)  # without a target it lists them
target=${1:-all}
amount=${2:-60}
case $amount in
  *x) limit=-runs=${amount%x} ;;
  *) limit=-max_total_time=$amount ;;
esac
if [ "$target" = all ]; then
  chosen=$names
elif grep -qx -- "$target" <<<"$names"; then
  chosen=$target
else
  echo "fuzz: unknown target '$target'; there are:" $names >&2
  exit 2
fi

# Filling and keeping freed memory takes most of the time and finds nothing here.
export ASAN_OPTIONS=max_malloc_fill_size=0:malloc_context_size=4:quarantine_size_mb=16
mkdir -p build/fuzz/found
failed=0
printf '%-20s %12s %10s %8s  %s\n' target executions per-second peak-MB outcome
for name in $chosen; do
  grown=build/fuzz/corpus/$name
  log=build/fuzz/$name.log
  mkdir -p "$grown"
  outcome=clean
  nice "$binary" --target="$name" "$limit" -max_len=2048 -len_control=0 -timeout=10 -rss_limit_mb=2500 \
    -malloc_limit_mb=1500 -reload=0 -print_final_stats=1 -dict=tests/fuzz/words.dict \
    -artifact_prefix="build/fuzz/found/$name-" "$grown" "tests/fuzz/corpus/$name" >"$log" 2>&1 ||
    { outcome=$(grep -aom1 'SUMMARY.*' "$log" || echo "failed, see $log"); failed=1; }
  figure() { grep -ao "stat::$1: *[0-9]*" "$log" | grep -o '[0-9]*$' || echo 0; }
  printf '%-20s %12s %10s %8s  %s\n' "$name" "$(figure number_of_executed_units)" \
    "$(figure average_exec_per_sec)" "$(figure peak_rss_mb)" "$outcome"
done
exit $failed
