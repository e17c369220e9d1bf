"""Checks of the numbers among the settings of a training."""

from __future__ import annotations

import math

from pointsdf_cli.errors import InputError


def option_of(name: str) -> str:
    """The command's option for a setting."""
    return "--" + name.replace("_", "-")


def require_positive(settings: object, *names: str) -> None:
    """Require settings to be positive and finite.

    Raises:
        InputError: One is not.
    """
    for name in names:
        value = getattr(settings, name)
        if not 0 < value < math.inf:
            raise InputError(f"{value} is not positive and finite", where=option_of(name))


def require_share(settings: object, name: str) -> None:
    """Require a setting to lie between 0 and 1, both excluded.

    Raises:
        InputError: It is not.
    """
    value = getattr(settings, name)
    if not 0.0 < value < 1.0:
        raise InputError(
            f"{value} is not a share", where=option_of(name), allowed="between 0 and 1"
        )
