#!/usr/bin/env python3
"""Build the firmware and the sample compass, and put the ELFs, each with a manifest, where the package ships them.

    python firmware_stub/build.py              build, check, and replace the shipped ELFs
    python firmware_stub/build.py --out DIR    the same into another folder

A copy of this folder outside hiltest's repository always needs --out, and is built in a temporary folder.
Needs arm-none-eabi-gcc, newlib for it, CMake, and ninja or make. The same sources give the
same loadable bytes from any folder.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from stack_check import StackError, stack_bytes

FIRMWARE = Path(__file__).resolve().parent
REPOSITORY = FIRMWARE.parent
SHIPPED = REPOSITORY / "src" / "hiltest" / "firmware"
NAME = "hiltest-frdm-k64f"
# Firmware of its own in a folder of its own, which is no source of the one above: its ELFs by what they send.
COMPASS = "compass"
COMPASSES = ("compass-lines", "compass-packets", "compass-lis3mdl", "compass-fxos8700cq", "compass-stm32f411")
SOURCE_SUFFIXES = {".c", ".h", ".S", ".ld", ".cmake", ".txt"}
PLACE = "place.py"  # decides what is built, as they do
COMPILER = "arm-none-eabi-gcc"
DEBIAN_PACKAGES = "gcc-arm-none-eabi libnewlib-arm-none-eabi cmake ninja-build"
BUILD = REPOSITORY / "build" / "firmware"
# A copy has neighbours that are somebody else's.
IN_REPOSITORY = FIRMWARE.name == "firmware_stub" and (SHIPPED.parent / "__init__.py").is_file()
STACK_LIMIT_BYTES = 8 * 1024  # what the linker script keeps free at least


def source_files(root: Path = FIRMWARE, *, compass: bool = False) -> list[Path]:
    """List every file that decides what is built, in a fixed order; the compass is built from those of both."""
    files = (path for path in root.rglob("*") if path.is_file())
    sources = (path for path in files if path.suffix in SOURCE_SUFFIXES or path.name == PLACE)
    wanted = (path for path in sources if compass or path.relative_to(root).parts[0] != COMPASS)
    return sorted(wanted, key=lambda path: path.relative_to(root).as_posix())


def source_hash(root: Path = FIRMWARE, *, compass: bool = False) -> str:
    """Hash names and contents of all sources; compiler flags are among them, in the CMake files."""
    digest = hashlib.sha256()
    for path in source_files(root, compass=compass):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(root).as_posix()}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()


def build_id(sources: str, *more: str) -> str:
    """Identify what these sources become: another compiler, or another name, makes another firmware of them."""
    made_of = (sources, compiler_version(), *more)
    return hashlib.sha256("".join(f"{each}\n" for each in made_of).encode()).hexdigest()[:16]


def compiler_version() -> str:
    """Return the first line of what the compiler says of itself."""
    return run(COMPILER, "--version").splitlines()[0]


def require(*tools: str) -> None:
    """Stop with the way out when a tool is missing."""
    missing = [tool for tool in tools if shutil.which(tool) is None]
    if missing:
        sys.exit(f"missing: {', '.join(missing)}. On Debian: apt install {DEBIAN_PACKAGES}")


def run(*command: str | Path) -> str:
    """Run a command; stop with its output when it fails."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{command[0]} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def remove_build(build: Path, source: Path) -> None:
    """Remove what an earlier build of these sources left; stop before a folder that holds anything else."""
    if not build.exists():
        return
    cache = build / "CMakeCache.txt"
    lines = cache.read_text(errors="replace").splitlines() if cache.is_file() else []
    homes = [Path(line.partition("=")[2]).resolve() for line in lines if line.startswith("CMAKE_HOME_DIRECTORY:")]
    if homes == [source.resolve()]:
        shutil.rmtree(build)
    elif not build.is_dir() or any(build.iterdir()):
        sys.exit(f"{build} is no build of {source}, and is not emptied: remove it, or name another folder with --build")


def compile_firmware(build: Path, digest: str, *, source: Path = FIRMWARE) -> Path:
    """Configure and build in an empty folder; return the ELF."""
    _compile(source, build, f"-DHILTEST_BUILD_ID={build_id(digest)}", toolchains=source)
    return build / f"{NAME}.elf"


def compile_compass(build: Path, digest: str, *, source: Path = FIRMWARE) -> list[Path]:
    """Configure and build the compass in an empty folder; return its ELFs."""
    ids = [f"-D{name.upper().replace('-', '_')}_BUILD_ID={build_id(digest, name)}" for name in COMPASSES]
    _compile(source / COMPASS, build, *ids, toolchains=source)
    return [build / f"{name}.elf" for name in COMPASSES]


def _compile(source: Path, build: Path, *definitions: str, toolchains: Path) -> None:
    remove_build(build, source)
    generator = "Ninja" if shutil.which("ninja") else "Unix Makefiles"
    toolchain = toolchains / "cmake" / "arm-none-eabi.cmake"
    run("cmake", "-G", generator, "-S", source, "-B", build, f"-DCMAKE_TOOLCHAIN_FILE={toolchain}", *definitions,
        "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON")
    run("cmake", "--build", build)


def section_sizes(elf: Path) -> dict[str, int]:
    """Sizes [bytes] of the sections that occupy memory, without the stack, which takes what is left."""
    listing = run("arm-none-eabi-size", "-A", elf)
    wanted = (".vectors", ".flash_config", ".text", ".ARM.exidx", ".fast_code", ".data", ".bss", ".noinit")
    found = dict(re.findall(r"^(\.\S+)\s+(\d+)", listing, re.MULTILINE))
    return {name: int(found[name]) for name in wanted if name in found}


def compile_flags(build: Path, source: Path) -> str:
    """The flags of an ordinary source file, without folders and without what belongs to the file."""
    commands = json.loads((build / "compile_commands.json").read_text())
    command = next(entry["command"] for entry in commands if entry["file"].endswith("/main.c"))
    flags = command.split()[1:]
    kept = [flag for flag in flags[: flags.index("-o")] if str(source) not in flag and str(build) not in flag]
    return " ".join(kept)


def manifest(elf: Path, build: Path, digest: str, *, source: Path = FIRMWARE) -> dict[str, object]:
    """Say what was built from what, with what."""
    return {
        "schema": "hiltest.firmware/1",
        "elf": elf.name,
        "elf_sha256": hashlib.sha256(elf.read_bytes()).hexdigest(),
        "build_id": build_id(digest, *(name for name in COMPASSES if name == elf.stem)),
        "source_sha256": digest,
        "compiler": compiler_version(),
        "flags": compile_flags(build, source),
        "section_bytes": section_sizes(elf),
        "deepest_stack_bytes": deepest_stack(build),
    }


def deepest_stack(build: Path) -> int:
    """Return the deepest stack [bytes]; stop when it is not known or too large."""
    try:
        depth = stack_bytes(build)
    except StackError as error:
        sys.exit(f"stack check: {error}")
    if depth > STACK_LIMIT_BYTES:
        sys.exit(f"stack check: {depth} bytes needed, {STACK_LIMIT_BYTES} are kept free")
    return depth


def main() -> None:
    """Build and install."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=SHIPPED if IN_REPOSITORY else None,
                        help="folder for the ELF and manifest.json")
    parser.add_argument("--build", type=Path, default=BUILD if IN_REPOSITORY else None,
                        help="folder to build in; an earlier build there is removed")
    arguments = parser.parse_args()
    if arguments.out is None:
        parser.error(f"{FIRMWARE} is outside hiltest's repository: say where the ELF goes, --out DIR")
    require(COMPILER, "cmake")
    if arguments.build is not None:
        install(arguments.build.resolve(), arguments.out)
    else:
        with tempfile.TemporaryDirectory() as folder:
            install(Path(folder).resolve(), arguments.out)


def install(build: Path, out: Path) -> None:
    """Build in one folder, and put ELFs and manifests into another."""
    digest = source_hash()
    ship(compile_firmware(build, digest), build, digest, out / "manifest.json")
    digest = source_hash(compass=True)
    for elf in compile_compass(build / COMPASS, digest):
        ship(elf, build / COMPASS, digest, out / f"{elf.stem}.json")


def ship(built: Path, build: Path, digest: str, described: Path) -> None:
    """Put an ELF beside its manifest."""
    described.parent.mkdir(parents=True, exist_ok=True)
    elf = Path(shutil.copyfile(built, described.with_name(built.name)))
    facts = manifest(elf, build, digest)
    described.write_text(json.dumps(facts, indent=2) + "\n")
    print(f"{elf}: build {facts['build_id']}, {facts['section_bytes']}, stack {facts['deepest_stack_bytes']}")


if __name__ == "__main__":
    main()
