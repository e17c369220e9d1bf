"""Commands that answer every input file by itself: names of the outputs, options that differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pointsdf_cli.choices import first_given
from pointsdf_cli.errors import InputError
from pointsdf_cli.io.hdf5 import OptionsDifferError, changed_options
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.io.untrusted import read_json

Value = TypeVar("Value")


def require_one_name_each(paths: Sequence[Path]) -> None:
    """Refuse inputs whose outputs would have one name.

    Raises:
        InputError: Two inputs have one stem.
    """
    first: dict[str, Path] = {}
    for path in paths:
        other = first.setdefault(path.stem.casefold(), path)
        if other is not path:
            raise InputError(
                f"{other} and {path} would be written to one file",
                where="--each",
                allowed="inputs of different names",
                hint="rename one, or run the command once for each folder",
            )


def one_for_each(values: Sequence[Value], count: int, option: str) -> list[Value | None]:
    """A value for each of `count` inputs: their own, one for all, or None where none was given.

    Raises:
        InputError: Another number of values.
    """
    own: list[Value | None] = [*values] or [None]
    if len(own) not in (1, count):
        raise InputError(
            f"{len(own)} for {count} inputs", where=option, allowed="one for all, or one each"
        )
    return own * count if len(own) == 1 else own


def check_each(each: bool, for_one: Mapping[str, object], jobs: int | None, skip_bad: bool) -> None:
    """Refuse options that do not fit the number of inputs.

    Args:
        each: Whether --each was given.
        for_one: Options that name one output or one question where there are many; None for those
            that were not given.
        jobs, skip_bad: Options that are for many inputs.

    Raises:
        InputError: One was given.
    """
    option = first_given(for_one if each else {"--skip-bad": skip_bad, "--jobs": jobs})
    if option and each:
        raise InputError(f"{option} with --each", where=option, hint="leave one of the two out")
    if option:
        raise InputError(f"{option} without --each", hint=f"add --each, or leave {option} out")


def is_done(out: Path, record: Path, config: Mapping[str, Any]) -> bool:
    """Whether `out` was made with these options, as the record beside it says.

    Args:
        out: File whose format has no place for its options.
        record: JSON file with them under "config", and the digest of `out` under "sha256".
        config: Options in plain types.

    Raises:
        OptionsDifferError: It was made with others, nothing says with which, or its contents are
            not those that were written.
        InputError: The record cannot be read, or a file of something else has its name.
    """
    told = read_json(record) if record.exists() else None
    theirs = told.get("config") if isinstance(told, Mapping) else None
    if not out.exists():
        if told is not None and not isinstance(theirs, Mapping):
            what = f"is no record of {out.name}, and is not overwritten without --force"
            raise InputError(what, where=record, hint="choose another --out, or add --force")
        return False
    if isinstance(told, Mapping) and theirs == config:
        # Older records have no digest.
        if told.get("sha256") not in (None, file_sha256(out)):
            raise OptionsDifferError.of_file(out, "is not as it was written: damaged or changed")
        return True
    changed = changed_options(theirs if isinstance(theirs, Mapping) else {}, config)
    raise OptionsDifferError.of_file(out, f"was made with other options ({', '.join(changed)})")
