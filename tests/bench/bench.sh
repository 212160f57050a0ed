#!/usr/bin/env bash
# Measurements: on real data sets through the command line, and the bench programs of this folder, which
# the release build builds. The data are not part of the project: LIGHTSKETCH_DATA names the folder that
# holds them (default: shared/data beside the checkout, which is where the programs look).
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
program=${LIGHTSKETCH:-$root/build/release/bin/lightsketch}
data=${LIGHTSKETCH_DATA:-$root/../shared/data}

usage() {
  cat <<'TEXT'
./run bench realrti     six RealRTI sets, every eighth light held out, full rank and by quality: PSNR, bytes
./run bench kill        a recording on the simulated rig, killed (kill -9) twenty times and gone on with
./run bench sets        DiLiGenT "cat" (16-bit, linear, light intensities) and 895 hand-held frames

./run bench lens        lenses from boards: against the truth, against OpenCV's calibrations, on real boards
./run bench boards      boards found in two real fisheye sets, against OpenCV's searches
./run bench ball        directions and poses from mirror balls; the highlights of a real ball
./run bench radiometry  response and exposure merge against OpenCV's, simulated and on a real bracket
./run bench response    the simulated rig's 8-bit camera, bracketed live: curve, hot pixels, vignetting against its truth
./run bench chain       the simulated rig from nothing: lenses, poses, recording; directions against its truth
./run bench recording   30 frames a second from both cameras: what is kept, dropped, and how soon it is decided; [--quick]

./run bench engine      compressing, drawing, loading against this machine's limits, and growth (lightsketch bench)
./run bench compress    the paper's job on a set with shadows and highlights; [quick]
./run bench quality     quality per byte: the paper, PCA, PTM, HSH, SH and our own sizes; [--quick] [--plot FILE.svg]
./run bench quality --model FILE.lsd   a model of 4096 lights at 640 x 480, to be drawn (ui/app/README.md)
./run bench faults      the fault matrix: every test of a fault, what was put in, what came of it
./run bench soak        the simulated rig with a fault every few seconds; [--minutes M] [--seed S]
./run bench light       light that changes every frame: a turned environment, a room camera, sized lamps
./run bench bad_frames  faults put into good sets: how many are found, and how many others
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
  local item way
  for item in 1 3 5 8 9 11; do need "rti/realrti_item$item"; done
  for way in full archive standard small; do
    local options=(--quality "$way")
    [ $way != full ] || options=(--block-rank full --rank full --storage f32)
    {
      echo "$heading"
      for item in 1 3 5 8 9 11; do
        measure "item$item" "$data/rti/realrti_item$item" every:8:4 "${options[@]}"
      done
    } | tee "$work/table"
    local bar='no bar'
    case $way in
      full) bar='goal 31.5 dB' ;;
      archive) bar='bar 31.5 dB at 20 bits per pixel' ;;
      small) bar='bar 30.5 dB at 8 bits per pixel' ;;
    esac
    awk -F'\t' -v way="$way" -v bar="$bar" 'NR > 1 { sum += $4; bits += $9; ++n } END {
      printf "%s: mean %.2f dB at %.1f bits per pixel (%s; best basis of RelightLab on these: 29.2 dB at 37)\n\n",
        way, sum / n, bits / n, bar }' "$work/table"
  done
}

sets() {
  need rti/diligent_cat
  need rti/relief_handheld
  echo "$heading"
  measure diligent_cat "$data/rti/diligent_cat" every:8:4
  measure relief_handheld "$data/rti/relief_handheld" cells:8:4
}

# Kills `record` at random moments. What the journal had acknowledged at each kill must stand, byte for
# byte, at the head of the final journal, and every frame must pass its checksum.
kill_recording() {
  local scene=127.0.9.11 source=127.0.9.12 round acknowledged
  "$program" rig --scene-address $scene --source-address $source --calibration "$work/rig" \
    >"$work/rig.log" 2>&1 &
  rig=$!
  until grep -q 'camera model' "$work/rig.log"; do
    kill -0 $rig || { cat "$work/rig.log" >&2; exit 1; }
    sleep 0.2
  done
  RANDOM=1
  for round in $(seq 1 20); do
    sleep 3.5 # until the cameras' heartbeat has freed them
    "$program" record --scene aravis:$scene --source aravis:$source --camera-model "$work/rig/source.json" \
      --rig "$work/rig/rig.json" --black-level 64 --ambient-seconds 0.5 --out "$work/sketch" \
      >"$work/record.log" 2>&1 &
    local record=$!
    sleep $((4 + RANDOM % 4)).$((RANDOM % 10))
    kill -9 $record 2>/dev/null || { echo "bench: record ended by itself:"; cat "$work/record.log"; exit 1; }
    wait $record 2>/dev/null || true
    # Whole lines only: a torn last one was never acknowledged.
    acknowledged=$(tail -c1 "$work/sketch/frames.jsonl" | wc -l)
    head -n "$(wc -l <"$work/sketch/frames.jsonl")" "$work/sketch/frames.jsonl" >"$work/journal.$round"
    printf 'kill %2d: %3d frames acknowledged%s\n' "$round" \
      "$(grep -c '"event":"frame"' "$work/journal.$round")" "$([ "$acknowledged" = 1 ] || echo ', a torn line')"
  done
  kill $rig
  for round in $(seq 1 20); do
    cmp -n "$(stat -c %s "$work/journal.$round")" "$work/journal.$round" "$work/sketch/frames.jsonl" ||
      { echo "bench: what kill $round had acknowledged is gone" >&2; exit 1; }
  done
  "$program" export "$work/sketch" --images exr --out "$work/export" --quiet
}

# bench_program NAME ARGUMENTS...
bench_program() {
  local program=$root/build/release/bin/bench_$1
  [ -x "$program" ] || { echo "bench: $program is not built; ./run build" >&2; exit 1; }
  shift
  exec "$program" "$@"
}

case "${1:-}" in
  realrti | sets | kill)
    work=$(mktemp -d "${TMPDIR:-/tmp}/lightsketch-bench.XXXXXX")
    rig=
    trap '[ -z "$rig" ] || kill $rig 2>/dev/null; rm -rf "$work"' EXIT
    case $1 in kill) kill_recording ;; *) "$1" ;; esac
    ;;
  lens | boards | radiometry | response | chain | recording | compress | quality | bad_frames | soak) bench_program "$@" ;;
  faults) exec "$root/tests/bench/faults.sh" ;;
  ball) bench_program mirror_ball ;;
  light) bench_program illumination ;;
  engine) shift && exec "$program" bench "$@" ;;
  '') usage ;;
  *)
    usage >&2
    exit 2
    ;;
esac
