"""The errors that a user can cause or must act on; all others are bugs and keep their traceback.

An error says what is wrong, where, what is allowed, and what to type next. `cli.main`, or a
script's `leave_with_message`, prints the message and leaves with `exit_code`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial


class RgraspError(Exception):
    """Something failed that is not a programming mistake (exit code 1).

    Args:
        what: The problem, as one sentence without a full stop.
        where: The file, option or dataset it is wrong in.
        allowed: Correct alternatives.
        hint: Next command or step.
    """

    exit_code = 1

    def __init__(
        self,
        what: str,
        *,
        where: object | None = None,
        allowed: str | None = None,
        hint: str | None = None,
    ) -> None:
        self.what = what
        self.where = None if where is None else str(where)
        self.allowed = allowed
        self.hint = hint
        super().__init__(self.message)

    @property
    def message(self) -> str:
        """The whole message, one line for each part that is known."""
        head = self.what if self.where is None else f"{self.where}: {self.what}"
        lines = [head]
        if self.allowed:
            lines.append(f"  allowed: {self.allowed}")
        if self.hint:
            lines.append(f"  try: {self.hint}")
        return "\n".join(lines)

    def __reduce__(self) -> tuple[object, ...]:
        # Exceptions with keyword arguments do not pickle by default; workers send these home.
        whole = partial(type(self), where=self.where, allowed=self.allowed, hint=self.hint)
        return whole, (self.what,)


class InputError(RgraspError):
    """The user's input or options cannot be used (exit code 2)."""

    exit_code = 2


@contextmanager
def leave_with_message() -> Iterator[None]:
    """Context of a script: prints an error of these, and leaves with its exit code.

    Raises:
        SystemExit: The block raised such an error.
    """
    try:
        yield
    except RgraspError as error:
        print(error.message, file=sys.stderr)
        sys.exit(error.exit_code)


@contextmanager
def as_input_error(
    where: object | None = None, kind: type[RgraspError] = InputError, or_named: bool = False
) -> Iterator[None]:
    """Raise an error of a block as an input error with the same message.

    Args:
        where: The place that it is about; None keeps the one that the error names.
        kind: Type of the error; others pass as they are.
        or_named: Keep the place that the error names, if it names one.

    Raises:
        InputError: The block raised an error of this kind.
    """
    try:
        yield
    except kind as error:
        place = error.where if where is None or (or_named and error.where) else where
        raise InputError(error.what, where=place, allowed=error.allowed, hint=error.hint) from error


def require_near(
    distance: float, most: float, what: str, where: object, hint: str | None = None
) -> None:
    """Refuse what lies farther away than anything of its kind: its unit or its origin is wrong.

    Args:
        distance: Its distance [m] from its origin; NaN is refused, too.
        most: Largest distance [m].
        what: Subject and verb, such as "the points lie".
        where: Source of the value.
        hint: Suggestion.

    Raises:
        InputError: It lies farther away.
    """
    if not distance <= most:
        raise InputError(
            f"{what} {distance:.4g} m away", where=where, allowed=f"up to {most:g} m", hint=hint
        )


class EmptyResultError(RgraspError):
    """The input is valid, but what was computed from it is empty (exit code 1)."""


class NoPlanError(RgraspError):
    """No configuration meets the constraints (exit code 3). Raised by the commands; in Python the
    plan's `status` and `reason` say so."""

    exit_code = 3


class UnlikelyPlanError(RgraspError):
    """There is a plan, and it is not likely to hold (exit code 4)."""

    exit_code = 4
