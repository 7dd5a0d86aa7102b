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

apt_install() {
    local install=(apt-get install -y --no-install-recommends --no-remove "$@")
    say "running ${install[*]}"
    as_root env DEBIAN_FRONTEND=noninteractive "${install[@]}" -qq >&2
}

is_debian_12() { grep -qx 'ID=debian' /etc/os-release && grep -qx 'VERSION_CODENAME=bookworm' /etc/os-release; } 2>/dev/null

# Debian 12's own Mesa 22.3 renders our kernels right, but llvmpipe takes 6 times as long as in the 25.0
# of its backports. Those come from the mirror in use; apt prefers them nowhere unless asked by name.
install_mesa() {
    local site list=/etc/apt/sources.list.d/holovol-backports.list
    # shellcheck disable=SC2016 # apt's own placeholders
    local targets=(apt-get indextargets --format '$(SITE)' 'Created-By: Packages' 'Component: main')
    if is_debian_12; then
        if [[ -z $("${targets[@]}" 'Codename: bookworm-backports') ]]; then
            site=$("${targets[@]}" 'Codename: bookworm' | sed -n 1p)
            if [[ -n $site ]]; then
                say "adding $list: Debian 12's own Mesa is 6 times slower than its backports'"
                echo "deb $site bookworm-backports main" | as_root tee "$list" >/dev/null
                as_root apt-get update -qq >&2 || true
                if [[ -z $("${targets[@]}" 'Codename: bookworm-backports') ]]; then
                    say "cannot reach the backports: taking Debian 12's own Mesa"
                    as_root rm -f "$list"
                fi
            fi
        fi
        if [[ -n $("${targets[@]}" 'Codename: bookworm-backports') ]]; then
            apt_install --target-release bookworm-backports mesa-vulkan-drivers && return
            say "the backports' Mesa does not install: taking Debian 12's own"
        fi
    fi
    apt_install mesa-vulkan-drivers
}

# Installs `packages`; never removes a package to make room for another.
install_packages() {
    ((${#packages[@]})) || return 0
    $may_install || die "not installing, as asked; install the above, or leave out --no-install"
    command -v apt-get >/dev/null ||
        die "there is no apt-get here; install the like of the above with this system's package manager"
    can_be_root ||
        die "installing needs root, and there is no sudo; as root, run: apt-get update && apt-get install -y --no-install-recommends ${packages[*]}"
    refresh_apt_lists
    local package others=() mesa=false
    for package in "${packages[@]}"; do
        if [[ $package == mesa-vulkan-drivers ]]; then
            mesa=true
        else
            others+=("$package")
        fi
    done
    ((${#others[@]} == 0)) || apt_install "${others[@]}"
    if $mesa; then
        install_mesa
    fi
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

has_library() { compgen -G "/usr/lib/$1" || compgen -G "/usr/lib/*/$1" || compgen -G "/usr/lib64/$1" || compgen -G "/usr/local/lib/$1"; } >/dev/null

has_display() { [[ $(uname -s) == Darwin || -n ${DISPLAY:-}${WAYLAND_DISPLAY:-} ]]; }

# What windows load at run time; desktops have most of it.
need_window() {
    [[ $(uname -s) == Linux ]] || return 0
    local package
    local -A libraries=(
        [libx11-xcb1]=libX11-xcb.so.1 [libxcursor1]=libXcursor.so.1 [libxi6]=libXi.so.6
        [libxrandr2]=libXrandr.so.2 [libxkbcommon-x11-0]=libxkbcommon-x11.so.0
    )
    for package in "${!libraries[@]}"; do
        has_library "${libraries[$package]}" || need "windows load it" "$package"
    done
}

# The display there is, or a virtual one.
need_any_display() {
    need_window
    has_display || { command -v Xvfb && command -v xauth; } >/dev/null ||
        need "virtual display: there is none to open windows on" xvfb xauth
}

# A machine with a GPU and any driver is left alone; another gets Mesa, whose llvmpipe runs on the CPU.
need_vulkan() {
    [[ $(uname -s) == Linux ]] || return 0
    has_library libvulkan.so.1 || need "Vulkan loader" libvulkan1
    if [[ -z ${VK_DRIVER_FILES:-}${VK_ICD_FILENAMES:-}${VK_ADD_DRIVER_FILES:-} && -z $(vulkan_drivers 'lvp_icd*.json') ]]; then
        if ! has_gpu || [[ -z $(vulkan_drivers '*.json') ]]; then
            need "Vulkan driver; without a GPU it renders on the CPU" mesa-vulkan-drivers
        fi
    elif ! has_gpu && [[ $(dpkg-query -W -f '${Version}' mesa-vulkan-drivers 2>/dev/null) == 22.* ]]; then
        say "note: this Mesa is 6 times slower than the one in bookworm-backports; it stays, since it is installed"
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
