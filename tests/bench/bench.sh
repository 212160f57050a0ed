#!/usr/bin/env bash
# Measurements on real data sets, through the command line alone. The data are not part of the
# project: LIGHTSKETCH_DATA names the folder that holds them (default: shared/data beside the checkout).
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
program=${LIGHTSKETCH:-$root/build/release/bin/lightsketch}
data=${LIGHTSKETCH_DATA:-$root/../shared/data}

usage() {
  cat <<'TEXT'
./run bench realrti     six RealRTI sets, every eighth light held out, full rank: PSNR per set and mean
./run bench sets        DiLiGenT "cat" (16-bit, linear, light intensities) and 895 hand-held frames
TEXT
}

need() {
  [ -e "$data/$1" ] || { echo "bench: $data/$1 is not here; set LIGHTSKETCH_DATA" >&2; exit 1; }
}

# measure NAME FOLDER HOLD-OUT OPTIONS...: import and validate; prints one row.
measure() {
  local name=$1 folder=$2 rule=$3
  shift 3
  "$program" import "$folder" --out "$work/$name" --quiet >"$work/$name.log" 2>&1 ||
    { cat "$work/$name.log" >&2; exit 1; }
  local start=$SECONDS
  "$program" validate "$work/$name" --hold-out "$rule" --report "$work/$name.report" \
    --json "$work/$name.json" --quiet "$@" >>"$work/$name.log" 2>&1 || { cat "$work/$name.log" >&2; exit 1; }
  jq -r --arg name "$name" --arg seconds $((SECONDS - start)) '
    def fixed(n): . * pow(10; n) | round / pow(10; n) | tostring;
    [$name, .model.captures, .mean.count, (.mean.psnrDb | fixed(2)),
     (.insideHull.psnrDb // 0 | fixed(2)), (.outsideHull.psnrDb // 0 | fixed(2)),
     (.mean.ssim // 0 | fixed(4)), (.mean.relativeError | fixed(4)), (.size.bitsPerPixel | fixed(1)),
     .model.lights, .model.rank, $seconds] | @tsv' "$work/$name.json"
  rm -rf "$work/$name" "$work/$name.report/model.lsd"
}

heading=$'set\tcaptures\theld out\tPSNR\tinside\toutside\tSSIM\trel.err\tbits/px\tlights\trank\tseconds'

realrti() {
  local item
  for item in 1 3 5 8 9 11; do need "rti/realrti_item$item"; done
  {
    echo "$heading"
    for item in 1 3 5 8 9 11; do
      measure "item$item" "$data/rti/realrti_item$item" every:8:4 --block-rank full --rank full --storage f32
    done
  } | tee "$work/table"
  awk -F'\t' 'NR > 1 { sum += $4; ++n } END {
    printf "\nmean PSNR over %d sets: %.2f dB (goal 31.5; best basis of RelightLab on these: 29.2)\n", n, sum / n }' "$work/table"
}

sets() {
  need rti/diligent_cat
  need rti/relief_handheld
  echo "$heading"
  measure diligent_cat "$data/rti/diligent_cat" every:8:4
  measure relief_handheld "$data/rti/relief_handheld" cells:8:4
}

case "${1:-}" in
  realrti | sets)
    work=$(mktemp -d "${TMPDIR:-/tmp}/lightsketch-bench.XXXXXX")
    trap 'rm -rf "$work"' EXIT
    "$1"
    ;;
  *) usage ;;
esac
