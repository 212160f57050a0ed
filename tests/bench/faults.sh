#!/usr/bin/env bash
# The fault matrix: runs every test whose name holds "Fault" and prints a row for each: what was put
# in, what came of it, whether it passed. Tests say the first two by RecordProperty("injected") and
# ("outcome"). Ends with 1 if any row failed.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
build=${LIGHTSKETCH_BUILD:-$root/build/release}
work=$(mktemp -d "${TMPDIR:-/tmp}/lightsketch-faults.XXXXXX")
trap 'rm -rf "$work"' EXIT
# Cameras do not wait: one test after the other.
GTEST_OUTPUT="json:$work/" ctest --test-dir "$build" -R Fault >"$work/log" 2>&1 || true
shopt -s nullglob
results=("$work"/*.json)
[ ${#results[@]} -gt 0 ] || { tail -n 5 "$work/log" >&2; echo "faults: no test ran; ./run build" >&2; exit 1; }
jq -r '.testsuites[] | .name as $suite | .testsuite[] | select(.result == "COMPLETED") |
  [$suite, .name, .injected // "", .outcome // "", if .failures then "FAILED" else "passed" end] | @tsv' \
  "${results[@]}" | sort -u >"$work/rows"
awk -F'\t' '$1 != last { printf "\n%s\n", $1; last = $1 }
  { printf "  %-44s %-52s %-7s\n%s", ($3 == "" ? $2 : $3), $4, $5, "" }' "$work/rows"
ran=$(wc -l <"$work/rows")
failed=$(grep -c 'FAILED$' "$work/rows" || true)
listed=$(ctest --test-dir "$build" -N -R Fault | sed -n 's/^Total Tests: //p')
printf '\n%d rows, %d failed' "$ran" "$failed"
[ "$ran" = "$listed" ] && echo || echo "; $((listed - ran)) did not finish"
[ "$failed" = 0 ] && [ "$ran" = "$listed" ]
