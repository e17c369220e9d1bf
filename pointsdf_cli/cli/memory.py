"""Detection of memory exhaustion, and of limits too low to start."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from pointsdf_cli.errors import RgraspError

_SAID = (
    "can't allocate memory",  # torch
    "cannot allocate memory",  # the system, the dynamic linker
    "failed to map segment",  # the dynamic linker under a limit of address space
    "out of memory",
    "not enough memory",
    "bad_alloc",
    "can't start new thread",  # a thread's stack is memory as well
    "unable to mmap",
    "unable to allocate",
    "insufficient memory",
)
LEAST = 1 << 30
"""Bytes of address space below which libraries hang or end the process while they load."""
NEAR = 0.8
"""Share of a limit of address space from which a failure may be due to that limit."""


def causes(error: BaseException) -> Iterator[BaseException]:
    """An exception, then each that it came of or was raised while handling, the last one first."""
    found: BaseException | None = error
    while found is not None:
        yield found
        found = found.__cause__ or found.__context__


def is_lack_of_memory(error: BaseException) -> bool:
    """Whether an error, or one of its causes, means that memory ran out.

    Near a limit (`ulimit -v`) any unexpected error counts: libraries that get no memory continue
    and fail somewhere else, as does the interpreter's own parser.
    """
    for found in causes(error):
        if isinstance(found, MemoryError):
            return True
        if isinstance(found, OSError) and found.errno == errno.ENOMEM:
            return True
        said_so = any(words in str(found).lower() for words in _SAID)
        if said_so and isinstance(found, (RuntimeError, ImportError, OSError, SystemError)):
            return True
    return _limit_was_near()


def require_address_space() -> None:
    """Refuse a limit under which not even the libraries can be loaded.

    Raises:
        RgraspError: The limit is below `LEAST`.
    """
    limit = _limit()
    if limit is not None and limit < LEAST:
        raise RgraspError(
            f"the limit of address space is {limit >> 20} MB, too little to begin",
            where="ulimit -v",
            allowed=f"{LEAST >> 20} MB or more",
            hint="ulimit -v unlimited",
        )


def _limit() -> int | None:
    """The limit of this process's address space in bytes; None without one."""
    with suppress(ImportError, OSError, ValueError):  # an operating system that has none
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        return None if limit == resource.RLIM_INFINITY else limit
    return None


def _limit_was_near() -> bool:
    limit = _limit()
    if limit is None:
        return False
    with suppress(OSError, ValueError):  # no Linux: not known
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmPeak:"):
                return 1024 * int(line.split()[1]) > NEAR * limit
    return False
