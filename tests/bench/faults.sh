#!/usr/bin/env bash
# The fault matrix: runs every test whose suite is named "Fault..." and prints a row for each: what was put
# in, what came of it, whether it passed. Tests say the first two by RecordProperty("injected") and
# ("outcome"); those in the virtual machine (tests/vm) too. Ends with 1 if any row failed.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
build=${LIGHTSKETCH_BUILD:-$root/build/release}
work=$(mktemp -d "${TMPDIR:-/tmp}/lightsketch-faults.XXXXXX")
trap 'rm -rf "$work"' EXIT
rows='(^|/)Fault|^vm\.'
# Cameras do not wait: one test after the other.
GTEST_OUTPUT="json:$work/" ctest --test-dir "$build" -V -R "$rows" >"$work/log" 2>&1 || true
shopt -s nullglob
results=("$work"/*.json)
[ ${#results[@]} -gt 0 ] || { tail -n 5 "$work/log" >&2; echo "faults: no test ran; ./run build" >&2; exit 1; }
jq -r '.testsuites[] | .name as $suite | select($suite | test("Fault")) | .testsuite[] | select(.result == "COMPLETED" or .result == "SKIPPED") |
  [$suite, .name, .injected // "", .outcome // "",
   if .failures then "FAILED" elif .result == "SKIPPED" then "skipped" else "passed" end] | @tsv' \
  "${results[@]}" | sort -u >"$work/rows"
awk -F'\t' '$1 != last { printf "\n%s\n", $1; last = $1 }
  { printf "  %-44s %-52s %-7s\n%s", ($3 == "" ? $2 : $3), $4, $5, "" }' "$work/rows"
ran=$(wc -l <"$work/rows")
failed=$(grep -c 'FAILED$' "$work/rows" || true)
# A machine's tests count as one here.
listed=$(ctest --test-dir "$build" -N -R "$rows" | sed -n 's/^Total Tests: //p')
machines=("$work"/vm_*.json)
in_machines=0
[ ${#machines[@]} -eq 0 ] ||
  in_machines=$(jq -r '.testsuites[] | select(.name | test("Fault")) | .testsuite[].name' "${machines[@]}" | wc -l)
missing=$((listed - (ran - in_machines + ${#machines[@]})))
grep -o 'SKIPPED: .*' "$work/log" | sort -u || true
printf '\n%d rows, %d failed' "$ran" "$failed"
[ "$missing" = 0 ] && echo || echo "; $missing did not finish"
[ "$failed" = 0 ] && [ "$missing" = 0 ]
