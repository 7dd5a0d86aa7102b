# Shared by the scripts here: finds the checkout, installs what is missing, chooses the target folder.
# Sourced, not run. Debian and Ubuntu are served by apt-get; elsewhere the missing parts are named.
# shellcheck shell=bash

set -euo pipefail

checkout=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
toolchain=$(sed -n 's/^channel *= *"\(.*\)"/\1/p' "$checkout/rust-toolchain.toml")

# Options that demo and test share; the rest stays in `arguments`.
install_only=false
may_install=true
arguments=()

say() { printf '%s: %s\n' "$(basename "$0")" "$*" >&2; }

die() {
    say "$@"
    exit 1
}

parse_arguments() {
    while (($#)); do
        case $1 in
            -h | --help)
                usage
                exit 0
                ;;
            --install-only) install_only=true ;;
            --no-install) may_install=false ;;
            *) arguments+=("$1") ;;
        esac
        shift
    done
}

# Packages to install, filled by `need`.
packages=()
apt_lists_are_fresh=false

# need WHY PACKAGE...
need() {
    say "missing: ${*:2} ($1)"
    packages+=("${@:2}")
}

as_root() {
    if ((EUID == 0)); then
        "$@"
    else
        sudo "$@"
    fi
}

can_be_root() { ((EUID == 0)) || command -v sudo >/dev/null; }

refresh_apt_lists() {
    $apt_lists_are_fresh || as_root apt-get update -qq >&2
    apt_lists_are_fresh=true
}

# Installs `packages`; never removes a package to make room for another.
install_packages() {
    ((${#packages[@]})) || return 0
    local install=(apt-get install -y --no-install-recommends --no-remove "${packages[@]}")
    $may_install || die "not installing, as asked; install the above, or leave out --no-install"
    command -v apt-get >/dev/null ||
        die "there is no apt-get here; install the like of the above with this system's package manager"
    can_be_root ||
        die "installing needs root, and there is no sudo; as root, run: apt-get update && ${install[*]}"
    say "running ${install[*]}"
    refresh_apt_lists
    as_root env DEBIAN_FRONTEND=noninteractive "${install[@]}" -qq >&2
    packages=()
}

# Whether apt has this package; of a fresh system only up-to-date lists can tell.
apt_offers() {
    command -v apt-cache >/dev/null || return
    if $may_install && can_be_root; then
        refresh_apt_lists
    fi
    [[ $(apt-cache policy "$1" 2>/dev/null) =~ Candidate:\ [^\(] ]]
}

need_compiler() {
    { command -v cc && command -v c++; } >/dev/null ||
        need "C and C++ compiler: Rust links with it, the FLIP measure is C++" g++ libc6-dev
}

# True when `cargo` here is the pinned toolchain's, or one at least as new.
cargo_is_new_enough() {
    local have
    have=$(cd "$checkout" && RUSTUP_AUTO_INSTALL=0 cargo --version 2>/dev/null | awk '{ print $2 }') || return 1
    [[ -n $have ]] && printf '%s\n%s\n' "$toolchain" "$have" | sort -VC
}

# Finds cargo where rustup puts it, though this shell's PATH may not have it yet.
find_cargo() {
    cargo_is_new_enough && return
    local bin=${CARGO_HOME:-$HOME/.cargo}/bin
    [[ -x $bin/cargo ]] || return
    export PATH=$bin:$PATH
    hash -r
    cargo_is_new_enough
}

# Debian 13 and Ubuntu 24.04 package rustup; not beside a packaged cargo, which stays.
# Elsewhere rustup's own installer is fetched.
need_rust() {
    find_cargo || command -v rustup >/dev/null || {
        if ! command -v cargo >/dev/null && apt_offers rustup; then
            need "Rust $toolchain comes through it" rustup
        elif ! command -v curl >/dev/null; then
            need "fetches the Rust installer" curl ca-certificates
        fi
    }
}

install_rust() {
    find_cargo && return
    $may_install || die "missing: Rust $toolchain; see https://rustup.rs, or leave out --no-install"
    if ! command -v rustup >/dev/null; then
        say "installing rustup from https://rustup.rs into ${CARGO_HOME:-$HOME/.cargo}"
        local installer
        installer=$(mktemp)
        curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs -o "$installer" ||
            die "cannot fetch the Rust installer; install Rust $toolchain by hand (https://rustup.rs), then run this again"
        sh "$installer" -y --no-modify-path --profile minimal --default-toolchain none >&2
        rm -f "$installer"
        export PATH=${CARGO_HOME:-$HOME/.cargo}/bin:$PATH
        hash -r
    fi
    say "installing the Rust toolchain $toolchain"
    rustup toolchain install "$toolchain" --profile minimal --component rustfmt --component clippy >&2 ||
        die "rustup cannot install Rust $toolchain; is the network there?"
}

# Installed Vulkan drivers (their manifests), by a pattern on the file name.
vulkan_drivers() {
    local folder
    for folder in /etc /usr/share /usr/local/share /usr/local/etc "${XDG_DATA_HOME:-$HOME/.local/share}"; do
        compgen -G "$folder/vulkan/icd.d/$1" || true
    done
}

has_gpu() {
    compgen -G '/dev/dri/renderD*' >/dev/null || [[ -e /dev/nvidiactl || -e /dev/dxg ]]
}

# A machine with a GPU and any driver is left alone; another gets Mesa, whose llvmpipe runs on the CPU.
# Seen working with our kernels: Mesa 22.3 (Debian 12's own) and 25.0 (its backports).
need_vulkan() {
    [[ $(uname -s) == Linux ]] || return 0
    local loader=(/usr/lib/libvulkan.so.1 /usr/lib/*/libvulkan.so.1 /usr/lib64/libvulkan.so.1 /usr/local/lib/libvulkan.so.1)
    local found=false file
    for file in "${loader[@]}"; do
        [[ -e $file ]] && found=true
    done
    $found || need "Vulkan loader" libvulkan1
    if [[ -z ${VK_DRIVER_FILES:-}${VK_ICD_FILENAMES:-}${VK_ADD_DRIVER_FILES:-} && -z $(vulkan_drivers 'lvp_icd*.json') ]]; then
        if ! has_gpu || [[ -z $(vulkan_drivers '*.json') ]]; then
            need "Vulkan driver; without a GPU it renders on the CPU" mesa-vulkan-drivers
        fi
    fi
}

# The workspace's own artifacts go: cargo names them by their path inside the checkout and compares
# times only, so another checkout with older files would be given them as its own.
forget_workspace_artifacts() {
    rm -rf "$CARGO_TARGET_DIR"/*/.fingerprint/{holovol,bevy_holovol}*
}

# One target folder outside all checkouts, so that a second checkout doesn't rebuild the dependencies.
use_target_folder() {
    : "${CARGO_TARGET_DIR:=${XDG_CACHE_HOME:-$HOME/.cache}/holovol/target}"
    export CARGO_TARGET_DIR
    mkdir -p "$CARGO_TARGET_DIR" ||
        die "cannot write the build folder $CARGO_TARGET_DIR; set CARGO_TARGET_DIR to one that can be written"
    local owner=$CARGO_TARGET_DIR/.holovol-checkout
    if [[ $(cat "$owner" 2>/dev/null) != "$checkout" ]]; then
        forget_workspace_artifacts
        printf '%s\n' "$checkout" >"$owner"
    fi
}

# Everything a build needs; a no-op, without root, where all of it is there.
prepare() {
    cd "$checkout"
    need_compiler
    need_rust
    need_vulkan
    install_packages
    install_rust
    if $install_only; then
        say "everything needed is installed"
        exit 0
    fi
    use_target_folder
}
