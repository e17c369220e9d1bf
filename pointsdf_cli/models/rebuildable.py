"""Networks that are built anew from the arguments of their constructor, as in config.json."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from torch import nn


class Rebuildable(nn.Module):
    """A network whose `config` gives the arguments of its `__init__`."""

    _arguments: Mapping[str, Any] = {}

    def keep_arguments(self, given: Mapping[str, Any]) -> None:
        """Keep the arguments for `config`.

        Args:
            given: `locals()` at the beginning of `__init__`; other variables are left out.
        """
        ours = inspect.signature(type(self)).parameters
        self._arguments = {name: plain(value) for name, value in given.items() if name in ours}

    def config(self) -> dict[str, Any]:
        """The arguments that rebuild it (plain types)."""
        return dict(self._arguments)


def plain(value: Any) -> Any:
    """Tuples and lists, at any depth, as the lists of config.json; other values unchanged."""
    return [plain(each) for each in value] if isinstance(value, tuple | list) else value
