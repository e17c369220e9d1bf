"""The one boundary where errors become messages and exit codes."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EACCES, EDQUOT, EFBIG, ENAMETOOLONG, ENOSPC, EPERM, EROFS
from types import FrameType
from typing import NoReturn

from pointsdf_cli import preload
from pointsdf_cli.cli.memory import causes, is_lack_of_memory, require_address_space
from pointsdf_cli.cli.printable import printable
from pointsdf_cli.deferred import defer_unused
from pointsdf_cli.errors import InputError, RgraspError

STOPPED = "rgrasp: stopped; what is finished is kept, the same command resumes"


def program() -> NoReturn:
    """Run `main` and end the process at once, without freeing the libraries' objects.

    Python would free a million of them one by one: a tenth of a plan's time.
    """
    code: object = None
    try:
        main()
    except SystemExit as leave:
        code = leave.code
    except BaseException:
        sys.excepthook(*sys.exc_info())
        code = 1
    if not isinstance(code, int | None):
        print(code, file=sys.stderr)
        code = 1
    atexit.unregister(preload.wait)  # nothing is taken apart here
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            code = code or 120  # as Python itself ends then
    os._exit(code or 0)


def main() -> None:
    """Run `rgrasp`.

    Exit codes: 0 done, 1 failed, 2 bad input or usage, 3 no plan exists, 4 the plan is not likely
    to hold, 130 stopped by Ctrl-C, 141 nobody reads the output any more, 143 a training stopped by
    SIGTERM.
    """
    _open_closed_streams()
    # Imports make hundreds of thousands of objects that stay: looking for garbage among them again
    # and again takes a tenth of the time.
    gc.set_threshold(1_000_000, 20, 20)
    for stream in (sys.stdout, sys.stderr):
        # A character that the terminal cannot show is not an error.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    try:
        _refuse_empty(sys.argv[1:])
        require_address_space()
        defer_unused()
        with _interruptible_imports():
            from pointsdf_cli.cli.app import app_of

            app_of(sys.argv[1:])()
    except RgraspError as error:
        print(printable(f"rgrasp: {error.message}"), file=sys.stderr)
        sys.exit(error.exit_code)
    except SystemExit as leave:
        # Typer has converted these exceptions to exit codes.
        handled = list(causes(leave))
        if any(isinstance(error, KeyboardInterrupt) for error in handled):
            print(STOPPED, file=sys.stderr)
            sys.exit(130)
        if any(isinstance(error, BrokenPipeError) for error in handled):
            _nobody_reads()
        try:
            sys.stdout.flush()  # here, and not when Python has ended and nobody can say what failed
        except BrokenPipeError:
            _nobody_reads()
        except OSError as error:
            _unheard(error)
        raise
    except Exception as error:
        if is_lack_of_memory(error):
            _too_little_memory(error)
        if not isinstance(error, OSError) or error.errno not in _NO_PLACE:
            raise
        if error.filename is None:
            _unheard(error)
        print(printable(f"rgrasp: {_told(error).message}"), file=sys.stderr)
        sys.exit(2)


_NO_PLACE = (ENOSPC, EDQUOT, EACCES, EROFS, EPERM, ENAMETOOLONG, EFBIG)


def _told(error: OSError) -> InputError:
    """Input error for an operating system error that names a file."""
    from pointsdf_cli.io.atomic import unwritable

    if error.errno not in (EACCES, EPERM):
        return unwritable(error.filename, error)
    # Whether it was to be read or written is not known here.
    allowed = "files and folders that you may read, an --out that you may write"
    return InputError("permission denied", where=error.filename, allowed=allowed)


def _open_closed_streams() -> None:
    """Replace closed streams (`rgrasp … >&-`) by /dev/null.

    Otherwise the next file to be opened, perhaps the output, gets the stream's number, and whatever
    a library prints is written into it.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "r" if number == 0 else "w", closefd=False))


def _refuse_empty(arguments: list[str]) -> None:
    """Refuse empty arguments: an unset shell variable would mean the current folder.

    Raises:
        InputError: An argument is empty.
    """
    for place, argument in enumerate(arguments):
        option, equals, value = argument.partition("=")
        if argument.strip() and not (option.startswith("-") and equals and not value.strip()):
            continue
        before = arguments[place - 1] if place else ""
        where = option if equals else before if before.startswith("-") else "the command line"
        allowed, hint = "a value, or to leave it out", "is a variable of your shell unset?"
        raise InputError("an argument is empty", where=where, allowed=allowed, hint=hint)


def _too_little_memory(error: BaseException) -> NoReturn:
    said = (str(error).splitlines() or [""])[0][:120]
    print(
        printable(f"rgrasp: not enough memory{f' ({said})' if said else ''}")
        + "\n  try: close other programs, raise `ulimit -v`, or ask for less (fewer --jobs, "
        "a lower --resolution, smaller files)",
        file=sys.stderr,
    )
    sys.exit(1)


def _nobody_reads() -> NoReturn:
    """End quietly because the reader of stdout has left, as in `rgrasp … | head`."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    sys.exit(141)


def _unheard(error: OSError) -> NoReturn:
    """Report that the output cannot be written; the files are complete."""
    print(f"rgrasp: the output cannot be written ({error.strerror})", file=sys.stderr)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    sys.exit(1)


@contextmanager
def _interruptible_imports() -> Iterator[None]:
    """Let Ctrl-C end the program at once while it loads libraries.

    Some of them guard their own imports with `except BaseException`: a KeyboardInterrupt there is
    lost, or becomes an ImportError, and a half-loaded library counts as missing. No work has begun
    that could be left half done.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        while frame is not None:
            if frame.f_code.co_filename.startswith("<frozen importlib"):
                os.write(2, f"{STOPPED}\n".encode())
                os._exit(130)
            frame = frame.f_back
        raise KeyboardInterrupt

    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not usual or threading.current_thread() is not threading.main_thread():
        yield  # SIGINT is ignored (`nohup … &`), or handled elsewhere
        return
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


if __name__ == "__main__":
    program()
