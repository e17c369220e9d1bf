"""Datasets of `ViewEvidence`, one row a view, in the artifacts that hold views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.visibility import SIZE, ViewEvidence, VisibilityImage
from pointsdf_cli.io.layout import Column


def evidence_layout(rows: str) -> dict[str, Column]:
    """The layout of the datasets, whose first axis is named `rows`."""
    return {
        "visibility_window": Column(f"f8 [{rows}, 4]", "1", "camera"),
        "visibility_seen": Column(f"i1 [{rows}, S, S]", "1", "camera", compress=True),
        "visibility_free": Column(f"f4 [{rows}, S, S]", "m", "camera", compress=True),
        "support_plane": Column(f"f8 [{rows}, 4]", "1, m", "camera"),
    }


def evidence_arrays(evidence: Sequence[ViewEvidence], count: int) -> dict[str, NDArray[Any]]:
    """Arrays of the datasets, with one row a view; NaN for an unknown window or plane.

    Args:
        evidence: Entry of each view; empty if nothing is known of any.
        count: Number of views.
    """
    evidence = evidence or (ViewEvidence(),) * count
    unknown, empty = np.full(4, np.nan), np.zeros((SIZE, SIZE), np.float32)
    nothing = VisibilityImage(unknown, empty > 0, empty)
    images = [view.visibility or nothing for view in evidence]
    planes = [unknown if v.support_plane is None else v.support_plane for v in evidence]
    side = (-1, SIZE, SIZE)
    return {
        "visibility_window": np.reshape([i.window for i in images], (-1, 4)),
        "visibility_seen": np.reshape([i.seen for i in images], side).astype(np.int8),
        "visibility_free": np.reshape([i.free for i in images], side).astype(np.float32),
        "support_plane": np.reshape(planes, (-1, 4)),
    }


def read_view_evidence(
    path: Path | str, datasets: Mapping[str, NDArray[Any]]
) -> tuple[ViewEvidence, ...]:
    """The evidence in datasets of `evidence_layout`.

    Raises:
        InputError: Visibility images of another size.
    """
    window, plane = datasets["visibility_window"], datasets["support_plane"]
    seen, free = datasets["visibility_seen"], datasets["visibility_free"]
    if seen.shape[1:] != (SIZE, SIZE):
        raise InputError(
            f"has visibility images of {seen.shape[1:]}", where=path, allowed=f"{SIZE} × {SIZE}"
        )
    return tuple(
        ViewEvidence(
            None if np.isnan(window[k]).any() else VisibilityImage(window[k], seen[k] > 0, free[k]),
            None if np.isnan(plane[k]).any() else plane[k],
        )
        for k in range(len(window))
    )
