"""A file that appears whole or not at all: written beside its name, synced, renamed (failure-catalogue G7)."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from .errors import EnvironmentLacks, InputError

_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextlib.contextmanager
def whole_file(path: Path, what: str) -> Iterator[IO[bytes]]:
    """A temporary file beside `path`, synced and renamed to it at the end; on any error or Ctrl-C it is removed.

    what: what is written, for messages. Raises InputError where the path cannot be written, EnvironmentLacks where the disk
    is full.
    """
    target = Path(os.path.realpath(path))  # a link keeps pointing where it points
    temporary = target.parent / f".lightgauge-{secrets.token_hex(8)}.tmp"
    try:
        if target.exists() and not target.is_file():  # root could put a file in the place of a device
            raise InputError(
                f"{path}: is not a file, so no {what} is written there; give the name of a file: --out FILE"
            )
        target.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
        _sync_folder(target.parent)
    except OSError as error:
        said = f"{path}: cannot be written ({error.strerror or error})"
        if error.errno in _DISK_FULL:
            raise EnvironmentLacks(f"{said}. To mend it: free space there, or --out FILE elsewhere") from None
        raise InputError(f"{said}; choose another place: --out FILE") from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _sync_folder(folder: Path) -> None:
    """Make a rename last through a power cut."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
