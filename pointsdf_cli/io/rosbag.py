"""Depth images, camera_info and transforms from ROS 2 bags (mcap or db3), by the rosbags package.

A bag is a folder with metadata.yaml, or a single .mcap or .db3 file.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import invert_transform, rotation_from_wxyz, transform
from pointsdf_cli.io.depth_messages import depth_of_message
from pointsdf_cli.io.input_files import check_input

SUFFIXES = (".mcap", ".db3")
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, TF = "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"
TRANSPORTS = ("compressed", "compressedDepth", "zstd")
MOST_FRAMES = 100
NEAR_IN_TIME = 1_000_000_000
"""A moving transform [ns] older or newer than this does not say where the camera was."""
GAP = 200_000_000
"""Longest time [ns] between two transforms to interpolate a motion in: 5 mm off at 1 m/s²."""
STATIC = -1  # the stamp of transforms that hold always
Edge = tuple[str, str]
Samples = list[tuple[int, Array]]
"""Stamps [ns], ascending, and transforms [4, 4]."""


@dataclass(frozen=True)
class DepthFrames:
    """Depth images of one topic.

    Attributes:
        topic: The topic.
        depths: f4 [n, height, width], m along z; 0 where the camera saw nothing.
        frame: The camera's frame of reference, such as camera_depth_optical_frame.
        stamps: [n] ns, as the camera set them.
        times: [n] ns, when they were recorded; another clock than the stamps', perhaps.
        number: Number of the first image, counted from 0 at the beginning of the bag.
    """

    topic: str
    depths: NDArray[np.float32]
    frame: str
    stamps: NDArray[np.int64]
    times: NDArray[np.int64]
    number: int


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a folder, .mcap or .db3 (or .bag, of ROS 1)."""
    return path.is_dir() or path.suffix.lower() in (*SUFFIXES, ".bag")


class Bag:
    """An open bag; use `open_bag`."""

    def __init__(self, path: Path, reader: Any, store: Any) -> None:
        self.path, self._reader, self._store = path, reader, store

    def topics(self, *kinds: str) -> list[str]:
        """Names of the topics of these message types."""
        return sorted({c.topic for c in self._reader.connections if c.msgtype in kinds})

    def messages(
        self, topics: Sequence[str], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[str, int, Any]]:
        """Topic, time of recording [ns] and message of everything on some topics, in order."""
        connections = [c for c in self._reader.connections if c.topic in topics]
        if connections:  # none would mean all
            for connection, time, raw in self._reader.messages(connections, start, stop):
                yield (connection.topic, time, self._store.deserialize_cdr(raw, connection.msgtype))

    def depth_topic(self, wanted: str | None) -> str:
        """The topic of depth images: the one that is wanted, or the only one named so.

        Raises:
            InputError: There is no such topic, or several are to choose from.
        """
        there = self.topics(IMAGE, COMPRESSED)
        if wanted is None:
            what = "which images are the depth images?"
            named = [t for t in there if "depth" in t]
            # The same images, compressed, are beside them.
            found = [t for t in named if t.rpartition("/")[2] not in TRANSPORTS] or named
        else:
            what, found = f"has no images on {wanted}", [t for t in there if t == wanted]
        if len(found) != 1:
            likely = [t for t in there if "depth" in t] or there
            raise InputError(
                what,
                where=self.path,
                allowed=", ".join(there) or "no image topics at all",
                hint=f"--topic {likely[0]}" if likely else None,
            )
        return found[0]

    def depth_frames(
        self, topic: str, index: int, time: float | None, count: int, scale: float | None = None
    ) -> DepthFrames:
        """Consecutive depth images of a topic.

        Args:
            topic: Topic of the depth images.
            index: The first one, from 0; from -1 backwards counts from the end.
            time: If given, the first image this many seconds after the bag's beginning instead.
            count: Number of images.
            scale: Metres a unit; None for those of the encoding.

        Raises:
            InputError: There are not so many images, they are no depth images, or differ in size.
        """
        start = None if time is None else self._reader.start_time + round(1e9 * time)
        first = index if index >= 0 else index + sum(1 for _ in self.messages([topic]))
        messages = islice(self.messages([topic], start), max(first, 0), max(first, 0) + count)
        found = [
            (message.header, recorded, depth_of_message(message, self.path, topic, scale))
            for _, recorded, message in messages
        ]
        if len(found) < count or first < 0:
            there = sum(1 for _ in self.messages([topic]))
            length = (self._reader.end_time - self._reader.start_time) / 1e9
            asked = f"image {index}" if count == 1 else f"images {index} to {index + count - 1}"
            after = "" if time is None else f" after {time:g} s"
            raise InputError(
                f"has {there} images on {topic}, and {asked}{after} asked for",
                where=self.path,
                allowed=f"--index {-there} to {there - 1} or --time 0 to {length:.1f}, and as many "
                "--frames as follow" if there else "a topic with images",
            )  # fmt: skip
        headers, times, depths = zip(*found, strict=True)
        if len({depth.shape for depth in depths}) > 1:
            raise InputError(f"images on {topic} differ in size", where=self.path)
        stamps = np.array([_nanoseconds(header.stamp) for header in headers])
        frame, number = headers[-1].frame_id.lstrip("/"), first if time is None else -1
        return DepthFrames(topic, np.stack(depths), frame, stamps, np.array(times), number)

    def camera_info(self, frames: DepthFrames, wanted: str | None) -> tuple[str, Any]:
        """Topic and message of the camera_info of depth images: beside their topic, or the only one
        of their frame.

        Raises:
            InputError: There is none, or several are to choose from.
        """
        there = self.topics(CAMERA_INFO)
        info = {t: message for t in there for _, _, message in islice(self.messages([t]), 1)}
        parts = frames.topic.split("/")
        base = parts[:-2] if parts[-1] in TRANSPORTS else parts[:-1]
        topic = wanted or "/".join([*base, "camera_info"])
        if topic not in there and wanted is None:
            about = {t: (i.header.frame_id.lstrip("/"), i.width, i.height) for t, i in info.items()}
            mine = frames.frame, *frames.depths.shape[:0:-1]
            same = [name for name in about if about[name] == mine]
            topic = same[0] if len(same) == 1 else topic
        message = info.get(topic)
        if message is None:
            raise InputError(
                f"has no camera_info for {frames.topic} (looked for {topic})",
                where=self.path,
                allowed=f"--info-topic: {', '.join(there)}" if there else "record it, too",
                hint="--intrinsics K.json gives them by hand",
            )
        return topic, message

    def transforms(self, first: int, last: int) -> dict[Edge, Samples]:
        """T_parent_child by (parent, child): the static ones, and the moving ones about images
        recorded from `first` to `last` [ns]. Invalid ones are left out, and their edge stays."""
        topics = self.topics(TF)
        fixed = [topic for topic in topics if topic.endswith("tf_static")]
        # A part of the bag only: it may hold an hour of the arm's motion.
        window = first - 2 * NEAR_IN_TIME, last + 2 * NEAR_IN_TIME
        moving = self.messages([t for t in topics if t not in fixed], *window)
        found: dict[Edge, Samples] = {}
        for topic, _, message in (*moving, *self.messages(fixed)):
            for item in message.transforms:
                edge = item.header.frame_id.lstrip("/"), item.child_frame_id.lstrip("/")
                samples, static = found.setdefault(edge, []), topic in fixed
                if static:
                    samples.clear()
                if (pose := _matrix(item.transform)) is not None:
                    samples.append((STATIC if static else _nanoseconds(item.header.stamp), pose))
        for samples in found.values():
            samples.sort(key=itemgetter(0))
        return found

    def doubtful(self, edge: Edge, samples: Samples, stamp: int) -> set[int]:
        """Times [ns] of transforms that show whether an edge moved about a stamp, where it cannot
        be interpolated; empty where it can.

        Raises:
            InputError: No valid transform is near.
        """
        times = [time for time, _ in samples]
        if times == [STATIC] or stamp in times:
            return set()
        if times and times[0] < stamp < times[-1]:
            before, after = (time for time, _ in _around(samples, stamp))
            return {before, after} if after - before > GAP else set()
        near = {time for time in times if abs(time - stamp) <= NEAR_IN_TIME}
        if not near:
            what, hint = "is no rotation and translation", "give --camera-pose"
            if times:
                away = min(abs(time - stamp) for time in times) / 1e9
                what = f"is {away:.1f} s from the image's stamp, or more"
                hint = f"does the camera's driver stamp by another clock? Or {hint}"
            what = f"the transform {edge[0]} → {edge[1]} {what}"
            raise InputError(what, where=self.path, hint=hint)
        return near


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """A bag, open for reading.

    Raises:
        InputError: No such bag, a damaged one, or one of ROS 1.
    """
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    if not path.exists():
        raise InputError("no such bag", where=path)
    for part in sorted(path.iterdir()) if path.is_dir() else [path]:
        if not part.is_dir():
            check_input(part, "bag")
    if path.suffix.lower() == ".bag":
        raise InputError(
            "is a bag of ROS 1",
            where=path,
            allowed="ROS 2 bags: a folder with metadata.yaml, .mcap or .db3",
            hint=f"rosbags-convert --src {path} --dst {path.with_suffix('')}",
        )
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise InputError(
            "is a folder without metadata.yaml, so no ROS 2 bag",
            where=path,
            hint=f"ros2 bag reindex {path}, or give the .mcap or .db3 file in it",
        )
    try:
        with Reader(path) as reader:
            # The messages read here are the same in every distribution since Foxy.
            yield Bag(path, reader, get_typestore(Stores.ROS2_HUMBLE))
    except InputError:
        raise
    except Exception as error:  # a damaged bag fails in any part of the libraries that read it
        reason = (str(error).splitlines() or [""])[0][:160] or type(error).__name__
        raise InputError(f"is not a readable ROS 2 bag ({reason})", where=path) from error


def chain(edges: Collection[Edge], world: str, camera: str) -> list[Edge] | None:
    """The edges of a tree from the world to the camera; None if nothing joins the two."""
    reached: dict[str, list[Edge]] = {world: []}
    waiting = [world]
    for at in waiting:
        for edge in edges:
            other = edge[1] if edge[0] == at else edge[0]
            if at in edge and other not in reached:
                reached[other] = [*reached[at], edge]
                waiting.append(other)
    return reached.get(camera)


def pose_at(transforms: dict[Edge, Samples], edges: list[Edge], world: str, stamp: int) -> Array:
    """T_world_camera [4, 4] through a chain of edges at a time [ns]: interpolated, and constant
    before the first sample and after the last."""
    pose, at = np.eye(4), world
    for edge in edges:
        (before, first), (after, last) = _around(transforms[edge], stamp)
        share = np.clip((stamp - before) / max(after - before, 1), 0.0, 1.0)
        both = scipy.spatial.transform.Rotation.from_matrix([first[:3, :3], last[:3, :3]])
        turn = scipy.spatial.transform.Slerp([0, 1], both)(share).as_matrix()
        step = transform(turn, (1 - share) * first[:3, 3] + share * last[:3, 3])
        pose = pose @ (step if edge[0] == at else invert_transform(step))
        at = edge[1] if edge[0] == at else edge[0]
    return pose


def _around(samples: Samples, stamp: int) -> Samples:
    """The samples before and after a stamp; outside of all, the first or last one twice."""
    at = bisect_left(samples, stamp, key=itemgetter(0))
    return [samples[max(at - 1, 0)], samples[min(at, len(samples) - 1)]]


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _matrix(pose: Any) -> Array | None:
    """A transform [4, 4]; None if it is no rotation and translation."""
    q, t = pose.rotation, pose.translation
    wxyz = np.array([q.w, q.x, q.y, q.z])
    if not (1e-6 < np.linalg.norm(wxyz) < np.inf and np.isfinite([t.x, t.y, t.z]).all()):
        return None
    return transform(rotation_from_wxyz(wxyz), [t.x, t.y, t.z])
