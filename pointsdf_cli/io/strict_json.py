"""JSON that any program can read: NaN and infinity become null.

Python writes `NaN`, which is not JSON: `jq` and browsers refuse the whole document.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def to_json(value: Any, indent: int | None = None) -> str:
    """`value` as JSON.

    Args:
        value: Mappings, sequences, arrays, numbers, texts, paths, None.
        indent: Spaces a level; all on one line if None.

    Raises:
        TypeError: It contains a value of another type.
    """
    return json.dumps(plain(value), indent=indent, ensure_ascii=False, allow_nan=False)


def plain(value: Any) -> Any:
    """`value` in the types of JSON, as it is read back.

    Args:
        value: As for `to_json`.
    """
    if hasattr(value, "tolist"):  # arrays, their scalars, tensors
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value
