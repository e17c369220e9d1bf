"""One camera's view of a table with a label for every point: object, other object, table, rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.camera.cleaning import Cleaning, clean, flying_pixels
from pointsdf_cli.camera.mask_edge import grown_mask
from pointsdf_cli.camera.segmentation import SegmentationConfig
from pointsdf_cli.camera.standing_objects import standing_objects
from pointsdf_cli.camera.table_objects import (
    BESIDE_MASK,
    LOOSE,
    OUTSIDE,
    TABLE,
    VOXEL,
    TableObjects,
    add_masked_object,
    segment_table,
)
from pointsdf_cli.errors import as_input_error
from pointsdf_cli.geometry.arrays import Array, Mask
from pointsdf_cli.geometry.frames import apply_transform, plane_in_camera
from pointsdf_cli.geometry.free_space import FreeSpace
from pointsdf_cli.geometry.voxels import Thinned, thin
from pointsdf_cli.io.clouds import Cloud, DepthImage
from pointsdf_cli.planning.object_choice import ListedObject, Reach, numbered

WORKSPACE = SegmentationConfig(low=(0.2, -0.9, -0.05), high=(1.6, 0.9, 0.6))
"""Default workspace. Wider than the bundled arm's reach, so that objects beyond are seen and
reported as out of reach."""

ANYWHERE = SegmentationConfig(low=(-5.0, -5.0, -0.05), high=(5.0, 5.0, 0.6))
"""Default workspace if the robot's pose is not known."""

ROBOT, UNCLEAN = -4, -5
"""Labels of the robot's points and of those that cleaning dropped, beside those of
`camera/table_objects.py`."""

GENEROUS = 0.1
"""Ratio of the other points under a mask to the object's. Above it, pixels under the mask that have
no depth are not taken for the object's."""


AT_BORDER, CUT = 1, 5
"""Distance [px] to the image's border, and the number of an object's pixels so near to it, from
which the border cuts the object off."""
STRIP, FILLED = 0.15, 0.2
"""Widest strip along a border in which a camera measures nothing, as a share of the image; it ends
at a row or column of which a larger share than `FILLED` has depths."""


@dataclass(frozen=True)
class LabelledView:
    """One camera's view, thinned to M of its N points.

    Attributes:
        name: Name of the cloud, for messages.
        cloud: The cloud, its N points in the camera's frame, its mask extended to the edge of the
            depth. If its pose was made from the table, no robot was seen, and some points lie where
            the robot will stand.
        voxel: i8 [N], the thinned point of each; -1 for those that cleaning dropped.
        points: [M, 3], camera frame, m.
        world: [M, 3], world, m.
        pixels: [M, 2], (u, v); None without an image.
        objects: Object of each thinned point, or one of the negative labels.
        listed: The objects, best to grasp first.
        T_world_camera: [4, 4].
    """

    name: str
    cloud: Cloud
    voxel: NDArray[np.int64]
    points: Array
    world: Array
    pixels: Array | None
    objects: TableObjects
    listed: list[ListedObject]
    T_world_camera: Array

    @property
    def label(self) -> NDArray[np.int64]:
        """The label [N] of every point."""
        known = self.voxel >= 0
        label = np.full(len(self.voxel), UNCLEAN, dtype=np.int64)
        label[known] = self.objects.label[self.voxel[known]]
        return label

    @cached_property
    def free(self) -> FreeSpace:
        """The places that this camera saw to be free."""
        measured, image = self.points, self.cloud.image
        if image is not None and len(measured):
            measured = np.concatenate([measured, image.beyond(float(measured[:, 2].max()))])
        return FreeSpace(measured, self.T_world_camera)

    def plane_in_camera(self, label: int) -> Array | None:
        """The plane [4] that an object stands on, in the camera's frame: (unit normal n that points
        up, offset d), n·x = d. None if none was seen."""
        plane = self.objects.plane_below(label)
        return None if plane is None else plane_in_camera(plane, self.T_world_camera)


@dataclass(frozen=True)
class Sighting:
    """The object in one camera's view, and the other evidence of that view.

    Attributes:
        object_points: [K, 3], all points of the object, cleaned, camera frame, m.
        other_points: [L, 3], all other measured points, thinned: table, background, other objects;
            camera frame, m. Points that cleaning dropped are in neither array.
        others_in_world: [J, 3], points of other objects above the table, thinned, world, m.
        cleaning: Report on cleaning the object's points.
        object_rays: [K, 2], tangents of pixels that a mask gives to the object and that have no
            depth; None without a mask or an image.
    """

    object_points: Array
    other_points: Array
    others_in_world: Array
    cleaning: Cleaning
    object_rays: Array | None


def label_view(
    cloud: Cloud,
    name: str,
    workspace: SegmentationConfig,
    on_robot: Callable[[Array], Mask] | None = None,
    reach: Reach | None = None,
    cleaned: bool = True,
) -> LabelledView:
    """Thin and clean a cloud with a pose, and segment the objects on its table.

    Args:
        cloud: Cloud of the table top; its pose is known.
        name: Name of the cloud, for messages.
        workspace: Part of the scene to use.
        on_robot: Function from points [M, 3] of the world to a mask of the robot's own.
        reach: Result of `object_choice.reach_of`; None if the robot's pose is not known.
        cleaned: Drop flying pixels and outliers.

    Raises:
        InputError: The cloud's frame is not known, or a mask covers nothing above the table.
    """
    if cloud.over_table:
        # This pose depends on the chosen object; the numbers must not depend on it.
        reach, workspace = None, ANYWHERE if workspace is WORKSPACE else workspace
    with as_input_error(name, or_named=True):
        points, _ = cloud.in_camera_frame()
    assert cloud.T_world_camera is not None
    thinned = thin_and_clean(points, cloud, cleaned)
    few = points[thinned.first]
    world = apply_transform(cloud.T_world_camera, few)
    camera = cloud.T_world_camera[:3, 3]
    own = np.zeros(len(world), dtype=bool) if on_robot is None else on_robot(world)
    label = np.full(len(world), ROBOT, dtype=np.int64)
    found = segment_table(world[~own], camera, workspace)
    label[~own] = found.label
    objects = replace(found, label=label)
    mask = cloud.mask
    if mask is not None:
        mask = _to_depth_edge(cloud, mask, thinned.voxel, label)
        objects = add_masked_object(mask[thinned.first], objects)
    pixels = None if cloud.pixels is None else cloud.pixels[thinned.first]
    place = image_place(few, pixels, cloud.image)
    listed = numbered(world, place, objects, standing_objects(objects, world, camera), reach)
    pose = cloud.T_world_camera
    cloud = replace(cloud, points=points, frame="camera", mask=mask, normals=None, colours=None)
    return LabelledView(
        name=name,
        cloud=cloud,
        voxel=thinned.voxel,
        points=few,
        world=world,
        pixels=pixels,
        objects=objects,
        listed=listed,
        T_world_camera=pose,
    )


def _to_depth_edge(
    cloud: Cloud, mask: Mask, voxel: NDArray[np.int64], label: NDArray[np.int64]
) -> Mask:
    """A mask [N] of a cloud's points extended to the edge of the depth, above the table only.

    Args:
        cloud: The cloud; without an image, the mask stays as it is.
        mask: bool [N].
        voxel: [N], as in `Thinned`.
        label: [M], labels of the thinned points.
    """
    if cloud.image is None or cloud.pixels is None:
        return mask
    u, v = cloud.pixels.astype(np.int64).T
    above = (label >= 0) | (label == LOOSE)
    marked, allowed = np.zeros((2, *cloud.image.depth.shape), dtype=bool)
    marked[v, u] = mask
    allowed[v, u] = (voxel >= 0) & above[voxel]
    focal = float(cloud.image.K[0, 0])
    return grown_mask(marked, cloud.image.depth, focal, allowed)[v, u]


def thin_and_clean(points: Array, cloud: Cloud, cleaned: bool) -> Thinned:
    """Thin points [N, 3] (camera frame) to one a voxel, without flying pixels and outliers, whose
    `voxel` is -1."""
    if cleaned and cloud.image is not None and cloud.pixels is not None:
        u, v = cloud.pixels.astype(np.int64).T
        kept = np.flatnonzero(~flying_pixels(cloud.image.depth, cloud.image.K[0, 0])[v, u])
        few = thin(points[kept], VOXEL)
        voxel = np.full(len(points), -1, dtype=np.int64)
        voxel[kept] = few.voxel
        return Thinned(kept[few.first], voxel)
    few = thin(points, VOXEL)
    if not cleaned:
        return few
    sound = clean(points[few.first], specks=False).kept
    return Thinned(few.first[sound], np.where(sound, np.cumsum(sound) - 1, -1)[few.voxel])


def image_place(points: Array, pixels: Array | None, image: DepthImage | None) -> Array:
    """Image coordinates of points [M, 3] in units of half the image: (0, 0) is the middle."""
    if pixels is not None and image is not None:
        half = np.array(image.depth.shape[::-1]) / 2
        return np.asarray((pixels - half) / half)
    direction = points[:, :2] / points[:, 2:]
    # The width of a cloud's image is not known: take that of the observed part.
    half = np.maximum(np.percentile(np.abs(direction), 99, axis=0), 1e-6)
    return np.asarray(direction / half)


def sighting(
    view: LabelledView, item: ListedObject, cleaned: bool = True, is_target: bool = True
) -> Sighting:
    """All points of an object, and the other evidence of the view.

    Args:
        view: The labelled view.
        item: One of its objects.
        cleaned: Drop specks and outliers of the object.
        is_target: Whether a mask applies to this object.
    """
    mine, mask = view.label == item.label, view.cloud.mask
    rays = None
    if mask is not None and is_target:
        mine &= mask
        # A generous mask takes in what returns nothing beside the object, too.
        if (mask & ~mine).sum() <= GENEROUS * mine.sum():
            rays = view.cloud.mask_rays
    points = view.cloud.points[mine]
    cleaning = clean(points) if cleaned else Cleaning(np.ones(len(points), dtype=bool))
    label = view.objects.label
    above = (label >= 0) | (label == LOOSE)
    kept, other = points[cleaning.kept], label != item.label
    return Sighting(kept, view.points[other], view.world[above & other], cleaning, rays)


def describe(view: LabelledView, item: ListedObject, seen: Sighting, place: bool = True) -> str:
    """Summary for the user: points kept, and points dropped by reason; without the object's place
    if the world is not the user's."""
    label = view.label
    count = {
        "outside the workspace": OUTSIDE,
        "on the table": TABLE,
        "in groups too small for an object": LOOSE,
        "beside the mask": BESIDE_MASK,
        "in the robot's place" if view.cloud.over_table else "on the robot": ROBOT,
    }
    dropped = [f"{n} {words}" for words, k in count.items() if (n := int((label == k).sum()))]
    kept = len(seen.object_points)
    others = int((label >= 0).sum()) - kept - seen.cleaning.dropped
    unclean = int((label == UNCLEAN).sum()) + seen.cleaning.dropped
    if others:
        dropped.append(f"{others} on other objects")
    if unclean:
        dropped.append(f"{unclean} by cleaning")
    total = sum(each.stands for each in view.listed) if item.stands else len(view.listed)
    masked = view.cloud.mask is not None
    which = "the masked object" if masked else f"object {item.number} of {total}"
    what = item.describe() if place else item.sides
    said = f"{which}, {what}: kept {kept} of {len(label)} points"
    said += f"; dropped {', '.join(dropped)}" if dropped else ""
    if item.unsplit:
        said += "; it may be several objects in contact: --mask selects one"
    if item.label in view.objects.cut:
        said += "; it goes on outside of the workspace, unseen: widen --workspace"
    if _is_cut_by_image(view, label == item.label):
        said += "; the image's border cuts it off: aim the camera at all of it"
    return said


def _is_cut_by_image(view: LabelledView, mine: Mask) -> bool:
    """Whether points of an object, a mask [N], lie at the border of what the image measured."""
    pixels, image = view.cloud.pixels, view.cloud.image
    if pixels is None or image is None:
        return False
    cut = np.zeros(int(mine.sum()), dtype=bool)
    for axis, side in enumerate((1, 0)):
        # Cameras measure nothing in a strip along some of the borders.
        size = image.depth.shape[side]
        filled = np.flatnonzero((image.depth > 0).mean(axis=1 - side) > FILLED)
        first = min((k for k in filled if k < STRIP * size), default=0)
        last = max((k for k in filled if k > (1 - STRIP) * size), default=size - 1)
        at = pixels[mine, axis]
        cut |= (at <= first + AT_BORDER) | (at >= last - AT_BORDER)
    return int(cut.sum()) >= CUT
