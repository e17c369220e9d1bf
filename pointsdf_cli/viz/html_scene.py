"""HTML page of a scene: WebGL without a library; nothing is fetched, so it works offline."""

from __future__ import annotations

import base64
import html
import json
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.viz.scene import Scene

_PLAIN = ("title", "slider", "rate", "captions", "facts", "bodies", "layers")
_PLAIN_OF_PART = ("name", "layer", "kind", "body", "frame", "opacity")


def scene_page(scene: Scene) -> str:
    """The page. Its data is one JSON object; arrays are base64 of little-endian numbers."""
    template = resources.files("pointsdf_cli.viz").joinpath("scene_page.html")
    # Escape "<", which could close the script element early.
    data = json.dumps(scene_as_json(scene)).replace("<", "\\u003c")
    page = template.read_text(encoding="utf-8").replace("<!--TITLE-->", html.escape(scene.title))
    script = f'<script id="scene" type="application/json">{data}</script>'
    return page.replace("<!--SCENE-->", script)


def scene_as_json(scene: Scene) -> dict[str, Any]:
    """The scene in plain types."""
    low, high = scene.bounds()
    return {
        **{name: getattr(scene, name) for name in _PLAIN},
        "low": low.tolist(),
        "high": high.tolist(),
        # By columns, as WebGL takes matrices.
        "poses": _base64(np.swapaxes(scene.poses, -1, -2), "<f4"),
        "parts": [
            {
                **{name: getattr(part, name) for name in _PLAIN_OF_PART},
                "vertices": _base64(part.vertices, "<f4"),
                "colours": _base64(np.clip(part.vertex_colours() * 255, 0, 255).round(), "u1"),
                "faces": None if part.faces is None else _base64(part.faces, "<u4"),
            }
            for part in scene.parts
        ],
    }


def _base64(array: NDArray[Any], kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array).astype(kind).tobytes()).decode("ascii")
