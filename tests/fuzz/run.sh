#!/usr/bin/env bash
# Builds the fuzz targets for coverage on stable Rust, as cargo-fuzz does on nightly but without its
# sanitizer, and runs each of them:  run.sh SECONDS [TARGET ...]
# Inputs: the target's own seeds, corpus/TARGET beside this script, and what earlier runs found.
set -euo pipefail

seconds=${1:-60}
shift || true
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cd "$here/../.."
base=${CARGO_TARGET_DIR:-target}
mkdir -p "$base/fuzz"
base=$(cd "$base" && pwd)
cargo=${CARGO:-cargo}

mapfile -t known < <(cd "$here/targets" && printf '%s\n' *.rs | sed 's/\.rs$//')
build=("$cargo" build --features fuzz/targets)
if [ -n "${CI:-}" ]; then
    # Compiling takes longer than running: counters in our own crates alone, what they depend on as tests have
    # it. Features of dependencies are those of the whole workspace for the same reason.
    build+=(--locked --workspace --config 'profile.dev.package.simulator.opt-level=1')
    RUSTC_WORKSPACE_WRAPPER=$here/rustc-coverage "${build[@]}" "${known[@]/#/--bin=}"
    programs=$base/debug
else
    # Named even though it is this machine's: the flags then stay out of build scripts and macros.
    host=$(rustc -vV | sed -n 's/^host: //p')
    RUSTFLAGS="$("$here/rustc-coverage" --flags)" "${build[@]}" -p fuzz --profile fuzz --bins \
        --target "$host" --target-dir "$base/fuzz/build"
    programs=$base/fuzz/build/$host/fuzz
fi

targets=("$@")
[ ${#targets[@]} -gt 0 ] || targets=("${known[@]}")

# Files that targets read and write lie in memory: commits wait for the disk otherwise.
scratch=$(mktemp -d "$([ -w /dev/shm ] && echo /dev/shm || echo /tmp)/spaceoctopus-fuzz-XXXXXX")
finish() {
    # Shells of targets that still run; each ends its program.
    jobs -p | xargs -r kill 2>/dev/null || true
    wait
    rm -rf "$scratch"
}
trap finish EXIT
trap 'exit 130' INT TERM

# Runs one target; says what came of it in one piece, as others run beside it.
run() {
    local target=$1 corpus=$base/fuzz/corpus/$1 artifacts=$base/fuzz/artifacts/$1 log=$base/fuzz/$1.log
    local kept=() running= status=0 longest length first last reached artifact
    mkdir -p "$corpus" "$artifacts" "$scratch/$target"
    # Until it has ended well: this shell may end before.
    touch "$scratch/$target.failed"
    export TMPDIR=$scratch/$target
    [ ! -d "$here/corpus/$target" ] || kept=("$here/corpus/$target")
    "$programs/$target" --seeds "$corpus"
    # Longest inputs: the longest seed four times over, at least 4 KiB.
    longest=$(find "$corpus" -name 'seed-*' -printf '%s\n' | sort -n | tail -1)
    length=$((longest * 4 > 4096 ? longest * 4 : 4096))
    trap '[ -z "$running" ] || kill "$running" 2>/dev/null; exit 130' INT TERM
    "$programs/$target" -max_total_time="$seconds" -timeout=25 -rss_limit_mb=4096 \
        -max_len=$length -print_final_stats=1 -artifact_prefix="$artifacts/" "$corpus" "${kept[@]}" \
        >"$log" 2>&1 &
    running=$!
    wait "$running" || status=$?
    running=
    # First and last state: `cov:` counts places of the program that were reached.
    first=$(grep -m1 'INITED' "$log" || true)
    last=$(grep -E '^#[0-9]+.*cov:' "$log" | tail -1 || true)
    {
        printf '==> %s: %d s\n' "$target" "$seconds"
        printf '    %s\n    %s\n' "$first" "$last"
        reached=$(sed -nE 's/.*cov: ([0-9]+).*/\1/p' <<<"$last")
        if [ "$status" -eq 0 ] && [ "${reached:-0}" -lt 100 ]; then
            echo '    coverage is not seen: the flags of this script no longer instrument the program'
            status=1
        fi
        if [ "$status" -ne 0 ]; then
            grep -vE '^#[0-9]+' "$log" | tail -30 || true
            artifact=$(find "$artifacts" -type f -newer "$scratch/$target" -printf '%T@ %p\n' | sort -n | tail -1 | cut -d' ' -f2-)
            printf '==> %s: FAILED; again with\n    %s %s\n' "$target" "$programs/$target" "${artifact:-}"
        fi
    } >"$scratch/$target.said"
    cat "$scratch/$target.said"
    [ "$status" -ne 0 ] || rm "$scratch/$target.failed"
}

# One a core.
cores=$(nproc)
for target in "${targets[@]}"; do
    while [ "$(jobs -rp | wc -l)" -ge "$cores" ]; do wait -n || true; done
    run "$target" &
done
wait
failed=()
for target in "${targets[@]}"; do
    [ ! -e "$scratch/$target.failed" ] || failed+=("$target")
done
if [ ${#failed[@]} -gt 0 ]; then
    # Once more at the end, where logs that are cut off are read.
    for target in "${failed[@]}"; do
        printf '==> %s said\n' "$target"
        grep -aE 'panicked|ERROR:|^assertion|SUMMARY|Base64' -A2 "$base/fuzz/$target.log" | cut -c1-300 | tail -12 || true
    done
    printf '==> failed: %s\n' "${failed[*]}"
    exit 1
fi
