#!/bin/sh
# Installs the application on the board, for xmutil. Run there, in the folder that `make package` made:
#
#   sudo sh install.sh              copies to /lib/firmware/xilinx/NAME and says how to load it
#   sudo sh install.sh --remove     takes it away again
#
# ROOT=/some/folder installs below another root (an image, or a test).
set -eu

fail() {
    echo "error: $1" >&2
    exit 2
}

cd "$(dirname "$0")"
[ "$#" -le 1 ] || fail "too many words; allowed: --remove"
[ "${1:---remove}" = --remove ] || fail "unknown option $1; allowed: --remove"
set -- "${1:-}" *.bit.bin
action=$1
shift
{ [ "$#" -eq 1 ] && [ -f "$1" ]; } || fail "expected one .bit.bin beside install.sh, found: $*"
name=${1%.bit.bin}
for file in "$name.dtbo" shell.json uio.conf; do
    [ -f "$file" ] || fail "$file is missing beside install.sh"
done

root=${ROOT:-}
target=$root/lib/firmware/xilinx/$name
options=$root/etc/modprobe.d/$name-uio.conf
mkdir -p "$root/lib/firmware/xilinx" "$root/etc/modprobe.d" 2>/dev/null || fail "cannot write below $root/lib: use sudo"
[ -w "$root/lib/firmware/xilinx" ] || fail "cannot write to $root/lib/firmware/xilinx: use sudo"

if [ "$action" = --remove ]; then
    rm -rf "$target" "$options"
    echo "removed $target"
    exit 0
fi

# dfx-mgr looks at a folder as soon as it appears: make it complete under another name first.
rm -rf "$target" "$target.new"
mkdir "$target.new"
cp "$name.bit.bin" "$name.dtbo" shell.json "$target.new/"
mv "$target.new" "$target"
cp uio.conf "$options"
echo "installed $target"
echo "load it:  sudo modprobe uio_pdrv_genirq; sudo modprobe u-dma-buf"
echo "          sudo xmutil unloadapp; sudo xmutil loadapp $name"
