#!/usr/bin/env bash
# Power cuts while a recording writes: no acknowledged frame may be lost.
#
#   power_cut.sh FOLDER VM_RECORDING CUT_POWER
#
# A virtual machine records onto a disk whose writes and flushes QEMU logs, and is killed. From the
# log come disks as cuts at several moments would have left them (cut_power.cpp): right after an
# acknowledgement arrived, and at random moments. A second machine mounts each and looks for the
# frames that had been acknowledged by then.
set -euo pipefail
folder=$1 recording=$2 cut_power=$3
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
frames=30 # acknowledged before the kill
cuts=12
PATH=$PATH:/usr/sbin
command -v mkfs.ext4 >/dev/null || { echo "SKIPPED: no mkfs.ext4; apt-get install e2fsprogs"; exit 77; }

disks=$folder/disks
rm -rf "$disks"
mkdir -p "$disks"
truncate -s 64M "$disks/blank"
mkfs.ext4 -q "$disks/blank"
cp --sparse=always "$disks/blank" "$disks/disk"
: >"$disks/writes"

# The machine that is killed. An acknowledgement that has arrived here stands for all that the log
# holds by now.
: >"$disks/acknowledged"
coproc machine {
  QEMU_ARGUMENTS="-pidfile $disks/pid -blockdev driver=file,node-name=disk,filename=$disks/disk
    -blockdev driver=file,node-name=log,filename=$disks/writes
    -blockdev driver=blklogwrites,node-name=logged,file=disk,log=log,log-sector-size=512
    -device virtio-blk-pci,drive=logged,write-cache=on" \
    exec "$here/vm.sh" "$folder" record "$recording"
}
machine_pid=$machine_PID
exec {from_machine}<&"${machine[0]}"
while read -r word number rest; do
  number=${number%$'\r'}
  if [ "$word" != ACK ]; then
    echo "$word $number $rest"
    continue
  fi
  echo "$((number + 1)) $(stat -c %s "$disks/writes")" >>"$disks/acknowledged"
  [ "$number" -lt $frames ] || kill -9 "$(cat "$disks/pid")" 2>/dev/null || true
done <&"$from_machine"
status=0
wait "$machine_pid" || status=$?
[ $status -ne 77 ] || exit 77
acknowledged=$(tail -n 1 "$disks/acknowledged" | cut -d' ' -f1)
echo "killed after frame ${acknowledged:-0} was acknowledged"
[ "${acknowledged:-0}" -ge $frames ] || exit 1

# Moments: the kill itself; half of the others right at an acknowledgement, half anywhere.
RANDOM=1
end=$(stat -c %s "$disks/writes")
arguments=""
for cut in $(seq $cuts); do
  line=$(sed -n "$((1 + RANDOM % acknowledged))p" "$disks/acknowledged")
  at=${line#* }
  [ $((cut % 2)) -eq 0 ] || at=$((at + RANDOM * (end - at) / 32768))
  [ "$cut" -ne 1 ] || at=$end
  wanted[cut]=$(awk -v at="$at" '$2 <= at { n = $1 } END { print n + 0 }' "$disks/acknowledged")
  cp --sparse=always "$disks/blank" "$disks/cut$cut"
  echo "cut $cut at byte $at of $end, ${wanted[cut]} frames acknowledged:" \
    "$("$cut_power" "$disks/cut$cut" "$disks/writes" "$at" "$cut")"
  arguments+=" -blockdev driver=file,node-name=cut$cut,filename=$disks/cut$cut"
  arguments+=" -device virtio-blk-pci,drive=cut$cut,serial=cut$cut"
done
QEMU_ARGUMENTS=$arguments "$here/vm.sh" "$folder" check "$recording" >"$disks/check.log" ||
  { cat "$disks/check.log"; exit 1; }

for cut in $(seq $cuts); do
  found=$(tr -d '\r' <"$disks/check.log" | sed -n "s/^FOUND cut$cut //p")
  echo "cut $cut: ${wanted[cut]} frames acknowledged, ${found:-none} found, all whole"
  [ "${found:--1}" -ge "${wanted[cut]}" ] || { echo "an acknowledged frame is lost"; exit 1; }
done
rm -rf "$disks"
case ${GTEST_OUTPUT:-} in # a row for the fault matrix
  json:*)
    cat >"${GTEST_OUTPUT#json:}vm_power_cut.json" <<JSON
{"testsuites": [{"name": "PowerCutFault", "testsuite": [{"name": "LosesNoAcknowledgedFrame", "result": "COMPLETED",
  "injected": "power cut while recording, $cuts moments", "outcome": "every acknowledged frame there and whole"}]}]}
JSON
    ;;
esac
