"""A scene in the browser, served by viser while the command runs."""

from __future__ import annotations

import io
import re
import time
from contextlib import redirect_stdout
from typing import Any

import numpy as np

from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.geometry.frames import wxyz_from_rotation
from pointsdf_cli.viz.scene import WORLD, Part, Scene
from pointsdf_cli.viz.viewer_access import free_port, guarded, only_controls


def plain(text: str) -> str:
    """Text of a file or its name for Markdown that shows HTML: every sign as an entity."""
    return re.sub(r"[^\w ]", lambda sign: f"&#{ord(sign[0])};", " ".join(text.split()))


class Viewer:
    """Server of one scene: a slider over its frames, a button to play them, a checkbox per layer.

    Args:
        scene: Scene to show.
        host: Address to listen at; "127.0.0.1" is reachable from this machine only.
        port: Port to listen at; if it is in use, the next free one.

    Attributes:
        port: Port to listen on.
        frame: The frame that is shown.

    Raises:
        RgraspError: viser is not installed.
        InputError: The host or port cannot be listened at.
    """

    def __init__(self, scene: Scene, host: str = "127.0.0.1", port: int = 8080) -> None:
        self.scene = scene
        viser = _import_viser()
        if not 1 <= port <= 65535:
            raise InputError(f"port {port}", where="--port", allowed="1 to 65535")
        port = free_port(host, port)
        # It prints a banner, and stdout is for results.
        with guarded(host) as started, redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(host=host, port=port, label=scene.title, verbose=False)
        if not started or not only_controls(self._server._websock_server):
            self._server.stop()
            raise RgraspError(
                "this version of viser serves in a way that cannot be guarded",
                hint="pip install -c constraints.txt '.[view]', or --export page.html",
            )
        self.port = int(self._server.get_port())
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.scene.set_up_direction("+z")
        self._bodies = [
            self._server.scene.add_frame(f"/bodies/{k}", show_axes=False)
            for k in range(len(scene.bodies))
        ]
        self._parts = [(part, self._add(i, part)) for i, part in enumerate(scene.parts)]
        self._hidden: set[str] = set()
        self.frame = 0
        self._look_at_it()
        self._add_controls()
        self.show(0)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving."""
        with redirect_stdout(io.StringIO()):
            self._server.stop()

    def show(self, frame: int) -> None:
        """Move every body to its pose in a frame."""
        self.frame = min(max(frame, 0), self.scene.frames - 1)
        with self._server.atomic():
            for body, handle in enumerate(self._bodies):
                pose = self.scene.pose(body, self.frame)
                handle.visible = bool(np.isfinite(pose).all())
                if handle.visible:
                    handle.position = pose[:3, 3]
                    handle.wxyz = wxyz_from_rotation(pose[:3, :3])
            self._show_parts()
        self._caption.content = plain(self.scene.captions[self.frame]) or " "

    def run(self) -> None:
        """Play while the button is on, until interrupted; from the end, anew."""
        playing = False
        while True:
            frame = int(self._slider.value)
            ended = frame + 1 >= self.scene.frames
            self._play.value = playing = self._play.value and not (playing and ended)
            if playing:
                self._slider.value = 0 if ended else frame + 1
            time.sleep(1 / self.scene.rate if playing else 0.1)

    def _show_parts(self) -> None:
        for part, handle in self._parts:
            now = part.frame is None or part.frame == self.frame
            handle.visible = now and part.layer not in self._hidden

    def _add(self, number: int, part: Part) -> Any:
        scene = self._server.scene
        above = "/world" if part.body == WORLD else f"/bodies/{part.body}"
        name = f"{above}/{number}"
        colours = (part.vertex_colours() * 255).round().astype(np.uint8)
        if part.kind == "points":
            size = max(float(np.ptp(self.scene.bounds(), axis=0).max()), 0.05) / 250
            return scene.add_point_cloud(name, part.vertices, colours, point_size=size)
        if part.kind == "lines":
            ends, colours = part.vertices.reshape(-1, 2, 3), colours.reshape(-1, 2, 3)
            return scene.add_line_segments(name, ends, colours, line_width=2.5)
        return scene.add_mesh_simple(
            name,
            part.vertices,
            part.faces,
            color=tuple(int(v) for v in colours[0]) if len(colours) else (150, 150, 150),
            opacity=None if part.opacity >= 1 else part.opacity,
            side="double",
            flat_shading=True,
            cast_shadow=False,
            receive_shadow=False,
        )

    def _look_at_it(self) -> None:
        low, high = self.scene.bounds()
        middle = (low + high) / 2
        away = 1.5 * max(float(np.linalg.norm(high - low)), 0.02)
        camera = self._server.initial_camera
        camera.look_at = tuple(middle)
        camera.position = tuple(middle + away * np.array([0.56, -0.71, 0.43]))

    def _add_controls(self) -> None:
        gui, scene = self._server.gui, self.scene
        rows = "\n".join(f"- **{plain(name)}** {plain(value)}" for name, value in scene.facts)
        gui.add_markdown(f"### {plain(scene.title)}\n{rows}")
        moves = scene.frames > 1
        last = max(scene.frames - 1, 1)
        self._slider = gui.add_slider(scene.slider, 0, last, 1, 0, visible=moves)
        self._play = gui.add_checkbox("play", False, visible=moves)
        self._caption = gui.add_markdown(" ", visible=moves)
        self._slider.on_update(lambda _: self.show(int(self._slider.value)))
        for layer in scene.layers:
            self._add_layer(layer)

    def _add_layer(self, layer: str) -> None:
        box = self._server.gui.add_checkbox(layer, True)

        def changed(_: Any) -> None:
            (self._hidden.discard if box.value else self._hidden.add)(layer)
            self._show_parts()

        box.on_update(changed)


def _import_viser() -> Any:
    try:
        import viser
    except ImportError as error:
        raise RgraspError(
            "the viewer needs viser, which is not installed",
            hint="in rgrasp's folder: pip install -c constraints.txt '.[view]', or "
            "--export page.html, which needs nothing",
        ) from error
    return viser
