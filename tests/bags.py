"""Small ROS 2 bags, written by rosbags' own writer, for tests."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import wxyz_from_rotation

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
FRAME = "camera_depth_optical_frame"
TOPIC = "/camera/depth/image_rect_raw"
BEGIN = 1_700_000_000_000_000_000


def header(time: int, frame: str = FRAME) -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=time // 10**9, nanosec=time % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def image(time: int, depth: NDArray[Any], encoding: str, frame: str = FRAME) -> Any:
    """An Image message of an array as it is stored, big-endian if the array is."""
    height, width = depth.shape[:2]
    data = np.frombuffer(depth.tobytes(), np.uint8)
    return TYPES["sensor_msgs/msg/Image"](
        header=header(time, frame), height=height, width=width, encoding=encoding,
        is_bigendian=int(depth.dtype.byteorder == ">"), step=data.size // height, data=data,
    )  # fmt: skip


def compressed(time: int, form: str, data: bytes) -> Any:
    return TYPES["sensor_msgs/msg/CompressedImage"](
        header=header(time), format=form, data=np.frombuffer(data, np.uint8)
    )


def png(values: NDArray[np.uint16], a: float = 0.0, b: float = 0.0) -> bytes:
    """The bytes of a compressedDepth image: format, two parameters, a PNG."""
    out = io.BytesIO()
    Image.fromarray(values).save(out, "PNG")
    return struct.pack("<iff", 0, a, b) + out.getvalue()


def camera_info(time: int, camera: Camera, d: Sequence[float] = (0, 0, 0, 0, 0)) -> Any:
    return TYPES["sensor_msgs/msg/CameraInfo"](
        header=header(time), height=camera.height, width=camera.width,
        distortion_model="plumb_bob", d=np.array(d, np.float64), k=camera.K.ravel(),
        r=np.eye(3).ravel(), p=np.hstack([camera.K, np.zeros((3, 1))]).ravel(), binning_x=0,
        binning_y=0, roi=TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
    )  # fmt: skip


def tf(time: int, edges: dict[tuple[str, str], Array]) -> Any:
    """A TFMessage of T_parent_child by (parent, child)."""
    vector, turn = TYPES["geometry_msgs/msg/Vector3"], TYPES["geometry_msgs/msg/Quaternion"]
    items = []
    for (parent, child), T in edges.items():
        w, x, y, z = wxyz_from_rotation(T[:3, :3]).tolist()
        pose = TYPES["geometry_msgs/msg/Transform"](
            translation=vector(*T[:3, 3].tolist()), rotation=turn(x, y, z, w)
        )
        items.append(
            TYPES["geometry_msgs/msg/TransformStamped"](
                header=header(time, parent), child_frame_id=child, transform=pose
            )
        )
    return TYPES["tf2_msgs/msg/TFMessage"](transforms=items)


def write_bag(path: Path, messages: Sequence[tuple[str, int, Any]], storage: str = "mcap") -> Path:
    """A bag of (topic, time [ns], message); "mcap" or "sqlite3"."""
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        topics: dict[str, Any] = {}
        for topic, time, message in messages:
            kind = message.__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(topics[topic], time, STORE.serialize_cdr(message, kind))
    return path
