"""Every capture of a folder through segment, mesh and plan, as one picture page.

    python pipelines/real_captures.py FOLDER --out page.png

A capture is a folder with `depth.png` (0.1 mm a step), `K.json` and, where they are known,
`color.jpg`, `T_world_camera.json` and `label.png` (the number of the object at each pixel), or a
cloud (`*.pcd`, `*.ply`). Without a pose the table that is seen is taken for z = 0. A row shows the
image, what stands on the table, the mesh from both sides, and the plan or its reason. With
`label.png` each of its objects also gets a row, cut out by its mask.
"""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib
import numpy as np
from PIL import Image

from pointsdf_cli.camera.scene_file import SceneFileOptions
from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.io.clouds import read_cloud
from pointsdf_cli.models.meshing import mesh_reconstruction
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.planning.grasp_planner import GraspPlanner, PlanOptions
from pointsdf_cli.planning.list_objects import list_objects
from pointsdf_cli.planning.object_view import ObjectView, bare_view, segmented_view
from pointsdf_cli.planning.plan_on_table import TablePlan, plan_on_table
from pointsdf_cli.planning.scene_input import read_scene
from pointsdf_cli.service.objects_picture import draw_numbers
from pointsdf_cli.service.plan_settings import scene_of_plan
from pointsdf_cli.viz.plan_picture import plan_picture
from pointsdf_cli.viz.reconstruction_gallery import GalleryRow, draw_gallery
from pointsdf_cli.viz.robot_picture import RobotMeshes

matplotlib.use("Agg")
import matplotlib.pyplot as plt

DEPTH_SCALE = 1e-4


@dataclass(frozen=True)
class Capture:
    """One file with the options that read it.

    Attributes:
        name: For the page.
        path: Depth image or cloud.
        files: Options for reading the file.
        pose: Pose as for `--camera-pose`; None for a cloud of an object alone.
        colour: Colour image, if there is one.
    """

    name: str
    path: Path
    files: SceneFileOptions
    pose: str | None
    colour: Path | None = None


def captures_in(folder: Path, only: str) -> list[Capture]:
    """All captures of a folder whose names begin with `only`."""
    found = []
    for place in sorted(folder.glob("*")):
        if not place.name.startswith(only):
            continue
        if place.suffix.lower() in (".pcd", ".ply"):
            found.append(cloud_capture(place))
            continue
        if not (place / "depth.png").exists():
            continue
        pose = place / "T_world_camera.json"
        colour = place / "color.jpg"
        files = SceneFileOptions(str(place / "K.json"), DEPTH_SCALE)
        capture = Capture(
            place.name,
            place / "depth.png",
            files,
            str(pose) if pose.exists() else "table",
            colour if colour.exists() else None,
        )
        found.append(capture)
        label = place / "label.png"
        if label.exists():
            for number in filter(None, np.unique(np.asarray(Image.open(label)))):
                masked = SceneFileOptions(
                    str(place / "K.json"), DEPTH_SCALE, mask=f"{label}:{number}"
                )
                name = f"{place.name}, mask {number}"
                found.append(Capture(name, capture.path, masked, capture.pose, capture.colour))
    return found


def cloud_capture(path: Path) -> Capture:
    """A cloud of a table; or of an object alone, if it lies around its camera: it is then read with
    the pose that the message proposes."""
    cloud = read_cloud(path)
    try:
        cloud.in_camera_frame()
    except InputError as error:
        proposed = re.search(r"such as ([-0-9.,e]+),", error.hint or "")
        if proposed is None:
            raise
        files = SceneFileOptions(frame="world")
        return Capture(f"{path.stem} (object alone)", path, files, proposed.group(1))
    return Capture(path.stem, path, SceneFileOptions(), "table")


class Page:
    """Rows of pictures, drawn as they come."""

    def __init__(self, scratch: Path) -> None:
        self._scratch = scratch
        self._planner = GraspPlanner()
        self._model = load_model()
        self.rows: list[tuple[str, list[Path | None], str]] = []

    def add(self, capture: Capture) -> str:
        """Run one capture; what came out in a sentence."""
        stem = self._scratch / f"{len(self.rows):03d}"
        pictures: list[Path | None] = [capture.colour, None, None, None]
        said: list[str] = []
        try:
            pictures[1] = self._segment(capture, stem)
            view = self._object(capture)
            said += [line.removeprefix(f"{capture.path}: ") for line in view.notes[-1:]]
            pictures[2] = self._mesh(capture, view, stem, said)
            pictures[3] = self._plan(capture, stem, said)
        except RgraspError as error:
            said.append(error.message)
        text = "\n".join(said)
        self.rows.append((capture.name, pictures, text))
        return text

    def _segment(self, capture: Capture, stem: Path) -> Path | None:
        if capture.files.frame == "world":
            return None
        listing = list_objects(capture.path, capture.files, capture.pose)
        path = stem.with_suffix(".segment.png")
        draw_numbers(path, listing, capture.colour)
        return path

    def _object(self, capture: Capture) -> ObjectView:
        if capture.files.frame == "world":
            return bare_view(capture.path, capture.files, capture.pose)
        return segmented_view(capture.path, capture.files, capture.pose, None, None, None)

    def _mesh(self, capture: Capture, view: ObjectView, stem: Path, said: list[str]) -> Path:
        shape = Reconstruction.from_cloud(
            self._model, view.points, np.zeros(3), evidence=view.evidence
        )
        made = mesh_reconstruction(shape, 128, 0.05, 25)
        sides = " × ".join(f"{100 * side:.0f}" for side in np.ptp(made.vertices, axis=0))
        said.append(f"mesh of {len(made.faces)} faces, {sides} cm along the camera's axes")
        path = stem.with_suffix(".mesh.png")
        row = GalleryRow(capture.name, view.points, (made.vertices, made.faces), None, shape.sdf)
        draw_gallery(path, [row])
        return path

    def _plan(self, capture: Capture, stem: Path, said: list[str]) -> Path:
        robot = self._planner.robot
        poses = [] if capture.pose is None else [capture.pose]
        given = read_scene([capture.path], poses, [capture.files])
        alone = capture.files.frame == "world"
        planned = plan_on_table(
            self._planner,
            given.clouds,
            [capture.name],
            target=given.target,
            segment="none" if alone else "auto",
        )
        said.append(outcome(planned))
        path = stem.with_suffix(".plan.png")
        plan = planned.answer.plan
        q = planned.start if plan.reason else plan.q
        plan_picture(
            path, RobotMeshes(robot), q, scene_of_plan(planned.result(PlanOptions())), "", ""
        )
        return path

    def save(self, out: Path) -> None:
        """Write the page."""
        shape = {"width_ratios": (3, 3, 8, 6), "wspace": 0.02, "hspace": 0.05}
        shape |= {"left": 0.01, "right": 0.99, "top": 1.0, "bottom": 0.0}
        size = (28, 4.4 * len(self.rows))
        figure, axes = plt.subplots(
            len(self.rows), 4, figsize=size, squeeze=False, gridspec_kw=shape
        )
        for row, (name, pictures, text) in zip(axes, self.rows, strict=True):
            for cell, picture in zip(row, pictures, strict=True):
                cell.axis("off")
                cell.set_anchor("N")  # the text goes below
                if picture is not None:
                    cell.imshow(np.asarray(Image.open(picture).convert("RGB")))
            place = row[0].get_subplotspec().get_position(figure)
            figure.text(place.x0, place.y0, f"{name}\n{text}", va="bottom", fontsize=11)
        figure.savefig(out, dpi=70)


def outcome(planned: TablePlan) -> str:
    """The plan or its reason in one sentence."""
    plan = planned.answer.plan
    if plan.reason:
        return f"no plan: {plan.reason}. {plan.sentence}"
    return f"plan: {plan.kind} grasp, probability {plan.success_probability:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("page.png"))
    parser.add_argument("--only", default="", help="Captures whose names begin so.")
    arguments = parser.parse_args()
    with TemporaryDirectory() as scratch:
        page = Page(Path(scratch))
        captures = captures_in(arguments.folder, arguments.only)
        if not captures:
            parser.error(f"{arguments.folder} holds no capture {arguments.only}*")
        for capture in captures:
            said = page.add(capture)
            print(f"== {capture.name}\n{said}", flush=True)
        page.save(arguments.out)


if __name__ == "__main__":
    main()
