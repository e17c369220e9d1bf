"""rgrasp: from one partial point cloud to a grasp of an object that nobody has modelled."""

__version__ = "0.1.0"
