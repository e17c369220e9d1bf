"""All families of procedural objects, and the weights of the default mix."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from pointsdf_cli.errors import InputError
from pointsdf_cli.objects import (
    assemblies,
    bottles,
    boxes,
    bricks,
    cutlery,
    fruit,
    household,
    pincers,
    rings,
    rounds,
    tools,
    toys,
    vessels,
)
from pointsdf_cli.objects.family import Family

FAMILIES: dict[str, Family] = {
    family.name: family
    for module in (
        *(boxes, rounds, bottles, vessels, fruit, tools, pincers, cutlery),
        *(rings, bricks, toys, household, assemblies),
    )
    for family in module.FAMILIES
}


def choose_families(names: Sequence[str] | None) -> tuple[Family, ...]:
    """The named families in the order of the table, or all of them for None.

    Raises:
        InputError: A name is unknown (the nearest ones are listed), or there is no name.
    """
    if names is None:
        return tuple(FAMILIES.values())
    if not names:
        raise InputError("no family is named", where="--families", hint="leave --families out")
    for name in names:
        if name not in FAMILIES:
            near = difflib.get_close_matches(name, FAMILIES, n=3, cutoff=0.5)
            raise InputError(
                f"there is no family {name!r}",
                where="--families",
                allowed=", ".join(sorted(FAMILIES)),
                hint=f"--families {near[0]}" if near else None,
            )
    return tuple(family for family in FAMILIES.values() if family.name in names)
