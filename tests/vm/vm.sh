#!/usr/bin/env bash
# Runs a scenario of `init` in a virtual machine: Debian's own kernel under QEMU, without KVM.
#
#   vm.sh FOLDER SCENARIO PROGRAM...
#
# FOLDER keeps the kernel and the initial file system for the next time; the PROGRAMs go into the
# guest's /bin with the libraries they need. QEMU_ARGUMENTS adds arguments, such as disks.
# Exit status: the scenario's; 77 where a virtual machine cannot be had here.
set -euo pipefail
folder=$1 scenario=$2
shift 2
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
modules=(virtio_pci virtio_blk crc32c_generic ext4 vivid uvcvideo vhci-hcd)

skip() {
  echo "SKIPPED: $*"
  exit 77
}

for tool in qemu-system-x86_64 busybox cpio depmod xz; do
  PATH=$PATH:/usr/sbin command -v $tool >/dev/null ||
    skip "no $tool; apt-get install qemu-system-x86 busybox-static cpio kmod xz-utils"
done
PATH=$PATH:/usr/sbin

# The kernel, as apt has it, unpacked; its modules; busybox.
build_image() {
  local release
  release=$(apt-cache depends linux-image-amd64 2>/dev/null |
    sed -n '0,/Depends: linux-image-\(.*-amd64\)$/s/.*Depends: linux-image-\(.*-amd64\)$/\1/p') || true
  [ -n "$release" ] || skip "apt knows no linux-image-amd64; run apt-get update"
  rm -rf package root ./*.deb
  apt-get download "linux-image-$release" >download.log 2>&1 ||
    skip "no kernel: $(grep -m1 ^E: download.log || echo 'apt-get download failed')"
  dpkg-deb -x ./*.deb package
  rm ./*.deb
  depmod -b package "$release"

  # Booted through PVH the kernel need not unpack itself, which takes a minute without KVM.
  local at
  at=$(LC_ALL=C grep -abom1 -P '\xfd7zXZ\x00' "package/boot/vmlinuz-$release" | cut -d: -f1)
  xz -dc --single-stream < <(tail -c "+$((at + 1))" "package/boot/vmlinuz-$release") >vmlinux

  mkdir -p root/bin root/proc root/sys root/dev
  cp "$(command -v busybox)" root/bin/busybox
  local module file
  for module in "${modules[@]}"; do
    modprobe -d package -S "$release" --show-depends "$module" | while read -r kind file _; do
      if [ "$kind" = insmod ]; then
        install -D -m 644 "$file" "root/lib/modules/$release/${file#*/"$release"/}"
      fi
    done
  done
  cp package/lib/modules/"$release"/modules.{order,builtin} "root/lib/modules/$release/"
  depmod -b root "$release" 2>/dev/null  # warns of lists that nobody asks for
  (cd root && find . | cpio -o -H newc --quiet) >base.cpio
  rm -rf package root
}

mkdir -p "$folder/image"
(
  flock 9
  cd "$folder/image"
  recipe=$(sha256sum <"$here/vm.sh")
  if [ "$(cat recipe 2>/dev/null)" != "$recipe" ]; then
    build_image
    echo "$recipe" >recipe
  fi
) 9>"$folder/image/lock"

# What changes goes into a second archive: programs with their libraries.
own=$folder/$scenario
rm -rf "$own"
mkdir -p "$own/files/bin"
ln -s "$here/init" "$own/files/init"
for program in "$@"; do
  ln -s "$program" "$own/files/bin/"
  ldd "$program" 2>/dev/null | grep -o '/[^ ]*' | while read -r library; do
    mkdir -p "$own/files${library%/*}"
    ln -sf "$library" "$own/files$library"
  done
done
(cd "$own/files" && find . | cpio -o -L -H newc --quiet) | cat "$folder/image/base.cpio" - >"$own/initrd"
rm -rf "$own/files"

# shellcheck disable=SC2086
timeout 280 qemu-system-x86_64 -machine q35,usb=off -accel tcg,thread=multi -cpu max -smp 2 -m 1024 \
  -nodefaults -display none -serial stdio -no-reboot -kernel "$folder/image/vmlinux" \
  -initrd "$own/initrd" ${QEMU_ARGUMENTS:-} \
  -append "console=ttyS0 quiet mitigations=off nokaslr tsc=reliable panic=-1 scenario=$scenario" |
  tee "$own/log" | grep --line-buffered -v '^RESULT ' || true
rm -f "$own/initrd"
# Where a test program would have left its results, for the fault matrix.
case ${GTEST_OUTPUT:-}$(grep -m1 -o "^RESULT" "$own/log" || true) in
  json:*RESULT) sed -n 's/\r$//; s/^RESULT //p' "$own/log" >"${GTEST_OUTPUT#json:}vm_$scenario.json" ;;
esac
grep -q "scenario $scenario ended with 0" "$own/log"
