"""`lightgauge`: parse, do, and turn every way to end into an exit code and one message."""

from __future__ import annotations

import errno
import importlib.metadata
import os
import shlex
import sys
import traceback
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from ..reference.errors import EnvironmentLacks, InputError
from . import verbs
from .cli_parser import build_parser
from .summary import plain

_FULL_DISK = (errno.ENOSPC, errno.EDQUOT)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command. argv: arguments without the program's name. Returns the exit code."""
    given = list(sys.argv[1:] if argv is None else argv)
    arguments = build_parser(_version()).parse_args(given)
    arguments.command = shlex.join(["lightgauge", *given])
    try:
        code = _guarded(arguments)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader of our output left; there is nobody to tell
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return verbs.OUR_FAULT


def _guarded(arguments: Namespace) -> int:
    """The verb's exit code, whatever it raises."""
    try:
        return verbs.VERBS[arguments.verb](arguments)
    except InputError as error:
        return _tell(f"error: {error}", verbs.BAD_INPUT)
    except EnvironmentLacks as error:
        return _tell(f"error: {error}", verbs.LACKING)
    except MemoryError:
        return _tell(
            "error: out of memory; coarser settings need less, as in --set placement.min_voxel=1", verbs.LACKING
        )
    except KeyboardInterrupt:
        return _stopped(arguments)
    except BrokenPipeError:
        raise
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] == "lightgauge":
            return _fault(error)
        return _tell(f"error: the package {error.name} is missing. To mend it: make setup", verbs.LACKING)
    except Exception as error:
        if isinstance(error, SystemError) and isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            return _stopped(arguments)  # Ctrl-C while a module of compiled code is imported
        if isinstance(error, OSError) and error.errno in _FULL_DISK:
            return _tell(f"error: no space left: {error.filename or arguments.command}", verbs.LACKING)
        if isinstance(error, OSError) and _under_out(error, arguments):
            return _tell(f"error: --out {arguments.out}: {error.strerror} ({error.filename})", verbs.BAD_INPUT)
        return _fault(error)


def _stopped(arguments: Namespace) -> int:
    """Says how to go on after Ctrl-C."""
    kept = "nothing of a bench is kept. Again" if arguments.verb == "bench" else "finished work is kept. To resume"
    return _tell(f"stopped; {kept}: {arguments.command}", verbs.STOPPED)


def _under_out(error: OSError, arguments: Namespace) -> bool:
    """Whether the system refused a file in the folder that the user named: not every folder says beforehand that it takes none."""
    out, name = getattr(arguments, "out", None), error.filename
    if out is None or not isinstance(name, str):
        return False
    return Path(name).absolute().is_relative_to(Path(out).absolute())


def _fault(error: Exception) -> int:
    traceback.print_exception(error)
    return _tell(f"internal error, our own fault: {type(error).__name__}: {error}", verbs.OUR_FAULT)


def _tell(message: str, code: int) -> int:
    sys.stderr.write("\n".join(plain(line) for line in f"lightgauge: {message}".splitlines()) + "\n")
    return code


def _version() -> str:
    try:
        return importlib.metadata.version("lightgauge")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


if __name__ == "__main__":
    sys.exit(main())
