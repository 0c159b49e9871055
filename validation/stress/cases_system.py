"""G1 … G10: the system around the method. Hostile files, limits, crashes, kills, damage, names, a machine that lacks something."""

from __future__ import annotations

from .case import Band, Case, Curve, at_least, at_most
from .late import late

MAX_PICTURE_MB = 100.6  # 2^25 pixels of three bytes: reference/scene/images.py
MIN_LLVM = 17


def _taken_pictures(megabytes: float) -> Band:
    return Band(1.0, 1.0) if megabytes <= MAX_PICTURE_MB else Band(0.0, 0.0)


def _taken_llvm(major: float) -> Band:
    return Band(1.0, 1.0) if major >= MIN_LLVM else Band(0.0, 0.0)


NONE = at_most(0.0)

FILES = (
    Case(
        id="G1", title="a scene file that runs code", parameter="elements in one another", unit="",
        scene="Mitsuba XML whose innermost element has the path of a shared library as its type; meshes outside the folder",
        values=(1.0, 2.0, 8.0, 32.0), log=True, whole=True, metric="count",
        curves=(
            Curve("libraries run", NONE, "a type must match ^[a-z0-9_]+$ and stand on a list (catalogue G1); 6 documents"),
            Curve("taken", NONE, "nor is such a document taken, nor any of 4 paths that lead out of the folder"),
            Curve("run by a plain loader", None, "Mitsuba's own loader runs the library's constructor before it finds no plugin in it",
                  stated=at_least(1.0)),
        ),
        measure=late("system_doors", "code_in_scene"),
    ),
    Case(
        id="G2", title="a small file that unpacks to gigabytes", parameter="unpacked size", unit="MB",
        scene="a texture of zeros, packed a thousandfold, of 1 kB to 4.2 MB",
        values=(1.0, 10.0, 70.0, 105.0, 1000.0, 4300.0), log=True, metric="1 for taken; MiB",
        curves=(
            Curve("taken", _taken_pictures, "up to 2^25 pixels; size limits are checked before anything is unpacked (catalogue G2)"),
            Curve("memory", at_most(3072.0), "80 bytes a pixel while the picture is shrunk, of at most 2^25"),
            Curve("refused without a name", NONE, "the refusal names the file and its pixels"),
            Curve("unpacked over packed", None, "the provocation: what it would have become", stated=at_least(900.0)),
        ),
        measure=late("system_doors", "unpacking"), breaks="taken", limit=0.5,
    ),
    Case(
        id="G3", title="meshes that lie", parameter="lies by, or corners that are no numbers", unit="",
        scene="a sheet of 4,225 corners as PLY: counts too large or too small, indices past the end or negative, NaN, infinity",
        values=(1.0, 2.0, 16.0, 256.0, 4000.0), log=True, whole=True, metric="files of 7",
        curves=(
            Curve("taken", NONE, "finite, in range and counted, or refused (catalogue G3)"),
            Curve("refused without a name", NONE, "the message names the mesh and the element"),
            Curve("taken by a plain loader", None, "Mitsuba 3.9 checks counts, and takes indices past the end", stated=at_least(1.0)),
        ),
        measure=late("system_doors", "lies"),
    ),
    Case(
        id="G9", title="names that are markup, formulas or escapes", parameter="length of the name", unit="signs",
        scene="a record whose scene, error and notes are </script>, =cmd, terminal escapes and turned text",
        values=(10.0, 100.0, 1000.0, 10_000.0, 100_000.0), log=True, whole=True, metric="count",
        curves=(
            Curve("scripts beyond its own", NONE, "all is escaped, and the policy names the page's own script by hash (G9)"),
            Curve("steering signs", NONE, "control signs are shown, not sent"),
            Curve("names that JSON changed", NONE, "the record keeps the name as it was"),
            Curve("NaN written", NONE, "NaN is no JSON"),
        ),
        measure=late("system_doors", "hostile_names"),
    ),
)  # fmt: skip

PROCESSES = (
    Case(
        id="G4", title="native crashes in mesh repair", parameter="meshes whose repair ends badly, of 6", unit="",
        scene="spheres with two flipped faces; the worker aborts, reads wild, hangs, overeats, is silent, or answers another mesh",
        values=(0.0, 3.0, 6.0), whole=True, metric="count; s",
        curves=(
            Curve("crashes not said", NONE, "a worker a mesh: its end is a note, or the refusal of that mesh (catalogue G4)"),
            Curve("sound meshes not mended", NONE, "the rest goes on"),
            Curve("taken though the front matters", NONE, "what could not be turned is refused where its front matters"),
            Curve("longest wait", at_most(5.0), "the limit is 1 s of clock, and a process must start"),
        ),
        measure=late("system_processes", "repair_crashes"),
    ),
    Case(
        id="G7", title="killed at any moment", parameter="killed after", unit="ms",
        scene="a process that writes one record over the other, killed by the system 12 times",
        values=(0.5, 2.0, 8.0, 32.0), log=True, metric="files of 12",
        curves=(
            Curve("half files", NONE, "old or new, never half: temporary file, fsync, rename (catalogue G7)"),
            Curve("half files, written plainly", None, "opened, emptied and filled, the record is found cut", stated=at_least(1.0)),
        ),
        measure=late("system_processes", "kills"),
    ),
    Case(
        id="G8", title="corrupted or stale caches", parameter="bits flipped", unit="",
        scene="kept results and bakes with bits turned at random places, 20 times; scenes with one setting changed",
        values=(1.0, 4.0, 16.0, 64.0), log=True, whole=True, metric="files of 20",
        curves=(
            Curve("damaged results used", NONE, "found by checksum, computed again (catalogue G8)"),
            Curve("damaged bakes used", NONE, "refused, with the file's name and the way out"),
            Curve("not rebuilt or not said", NONE, "what is stored anew is read as it was"),
            Curve("stale results used", NONE, "each of 6 settings is part of the key"),
            Curve("damaged used, without a checksum", None, "a plain .npy of the numbers is read", stated=at_least(5.0)),
        ),
        measure=late("system_cache", "damage"),
    ),
    Case(
        id="G10", title="LLVM or OpenCL missing or too old", parameter="LLVM's major version", unit="",
        scene="Dr.Jit with LLVM 14 to 20; at the oldest also whole runs without LLVM, without OpenCL, without a linker",
        values=(14.0, 15.0, 16.0, 17.0, 19.0, 20.0), whole=True, metric="1 for taken; count",
        curves=(
            Curve("taken", _taken_llvm, "15 and 16 abort the process in the first kernel with a min or max; 17 and later work"),
            Curve("refused without a line", NONE, "the message holds the line that mends it"),
            Curve("runs that end otherwise", NONE, "exit code 3 and the line, nothing written, before any kernel runs (catalogue G10)",
                  where=lambda major: major == 14.0),
        ),
        measure=late("system_processes", "lacking"), breaks="taken", limit=0.5,
    ),
)  # fmt: skip

KERNELS = (
    Case(
        id="G5", title="recompilation in a loop", parameter="iterations", unit="",
        scene="the coarse Cornell box, lit anew each time: patches, probes, tiles, samples",
        values=(1.0, 2.0, 4.0, 8.0, 16.0), log=True, whole=True, metric="kernels compiled",
        curves=(
            Curve("kernels compiled", NONE, "after the first few iterations there is nothing new to compile (catalogue G5)"),
            Curve("with a literal", None, "one a time: 59 misses of 60 (catalogue G5)", stated=lambda n: Band(n - 1.0, n)),
            Curve("with dr.opaque", NONE, "an opaque number is data, not code"),
        ),
        measure=late("system_kernels", "compiled"),
    ),
    Case(
        id="G6", title="memory growth", parameter="warm iterations", unit="",
        scene="the coarse Cornell box, lit anew each time: patches, probes, tiles, samples",
        values=(30.0, 60.0, 120.0), log=True, whole=True, metric="MiB per 100 iterations",
        curves=(
            Curve("memory kept", at_most(1.0), "under 1 MB per 100 warm iterations (catalogue G6)"),
            Curve("64 KiB kept each time", None, "a leak of that size is seen: 6.25 MiB", stated=lambda _: Band(5.0, 8.0)),
        ),
        measure=late("system_kernels", "grown"),
    ),
)  # fmt: skip

CASES: tuple[Case, ...] = (*FILES, *PROCESSES, *KERNELS)
