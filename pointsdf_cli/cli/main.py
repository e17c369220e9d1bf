"""The one boundary where errors become messages and exit codes."""

from __future__ import annotations

import errno
import os
import sys

from pointsdf_cli.errors import RgraspError


def main() -> None:
    """Run `rgrasp`. Exit codes: 0 done, 1 failed, 2 bad input or usage, 3 no plan exists."""
    from pointsdf_cli.cli.app import app

    try:
        app()
    except RgraspError as error:
        print(f"rgrasp: {error.message}", file=sys.stderr)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        print(
            "rgrasp: stopped; what is finished is kept, the same command resumes", file=sys.stderr
        )
        sys.exit(130)
    except BrokenPipeError:
        # `rgrasp … | head`: the reader has left, and so do we, without a second complaint at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)
    except OSError as error:
        if error.errno in (
            errno.ENOSPC,
            errno.EDQUOT,
            errno.EACCES,
            errno.EROFS,
            errno.EPERM,
            errno.ENAMETOOLONG,
            errno.EFBIG,
        ):
            from pointsdf_cli.io.atomic import unwritable

            print(
                f"rgrasp: {unwritable(error.filename or 'output', error).message}", file=sys.stderr
            )
            sys.exit(2)
        raise


if __name__ == "__main__":
    main()
