"""Answers to requests, as bytes and their type."""

from __future__ import annotations

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.plans import plan_as_json, write_plan
from pointsdf_cli.io.scratch import Scratch
from pointsdf_cli.io.strict_json import to_json
from pointsdf_cli.io.trees import tree_to_npz
from pointsdf_cli.planning.object_view import bare_cloud, segmented_cloud
from pointsdf_cli.planning.table_top import workspace_of
from pointsdf_cli.robot.start import start_configuration
from pointsdf_cli.service.bodies import HDF5, JSON, NPZ, MeshBody, PlanBody, SceneBody, ScoreBody
from pointsdf_cli.service.resident import Resident
from pointsdf_cli.service.results import result_tree


def plan_answer(resident: Resident, body: PlanBody, form: str) -> tuple[bytes, str]:
    """Plan a grasp of an object in the clouds: configuration, motion, scores, or the reason for
    none."""
    require_expected(resident, body)
    result = resident.plan(body.request())
    if form == NPZ:
        return tree_to_npz(result_tree(result)), NPZ
    if form == HDF5:
        with Scratch() as folder:
            path = folder / "plan.h5"
            write_plan(path, result.plan, seed=body.seed, config=result.options)
            return path.read_bytes(), HDF5
    return to_json({**plan_as_json(result.plan), **result.messages()}).encode(), JSON


def mesh_answer(resident: Resident, body: MeshBody, form: str) -> tuple[bytes, str]:
    """Complete one partial cloud of an object to a closed mesh, in the cloud's frame."""
    require_expected(resident, body)
    given = body.clouds[0]
    if body.segment == "none":
        view = bare_cloud(given.cloud(), given.name, body.clean)
    else:
        robot = resident.robot
        cloud, wanted, corners = given.cloud(), body.wanted(), workspace_of(body.corners())
        q = start_configuration(body.start, robot)
        view = segmented_cloud(cloud, given.name, robot, wanted, corners, body.clean, q)
    completed = resident.mesh(view, body.choices(), given.name)
    made = completed.mesh
    answer = {
        "vertices": apply_transform(view.T_frame_camera, made.vertices),
        "faces": made.faces,
        "frame": view.frame,
        "report": view.notes,
        "parts_dropped": made.parts_dropped,
        "queries": made.queries,
        "seconds": completed.seconds,
        "warnings": completed.warnings,
    }
    return (tree_to_npz(answer), NPZ) if form == NPZ else (to_json(answer).encode(), JSON)


def score_answer(resident: Resident, body: ScoreBody, form: str) -> tuple[bytes, str]:
    """Predict how likely given grasps of an object in the clouds are to hold."""
    require_expected(resident, body)
    answer = {"success_probability": resident.score(body.request(), body.q)}
    return (tree_to_npz(answer), NPZ) if form == NPZ else (to_json(answer).encode(), JSON)


def require_expected(resident: Resident, body: SceneBody) -> None:
    """Refuse to answer with another robot, other weights or another version than expected.

    Raises:
        InputError: One of these differs.
    """
    own = resident.identity()
    for name, wanted in body.expects.model_dump().items():
        if wanted is not None and wanted != own[name]:
            option = name.replace("_", "-")
            raise InputError(
                f"the server has another {name.replace('_', ' ')} ({own[name][:12]}, not "
                f"{wanted[:12]})",
                where="--server",
                hint=f"start `rgrasp serve` with the same --{option}"
                if name != "version"
                else "install the same version on both sides",
            )
