"""PLY files: binary, little endian, float coordinates in metres, uchar colours of vertices."""

import numpy as np

VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])
TRIANGLE = np.dtype([("count", "u1"), ("corners", "<i4", (3,))])
_PLY_TYPES = {"f4": "float", "u1": "uchar"}


def ply_bytes(points_m: np.ndarray, colors: np.ndarray, triangles: np.ndarray | None = None) -> bytes:
    """Return the content of a binary PLY file, with float coordinates in metres and uchar colours.

    Args:
        points_m: (V, 3), ego frame.
        colors: (V, 3) uint8 RGB.
        triangles: (T, 3) indices of points; None for a point cloud.
    """
    vertices = np.empty(len(points_m), VERTEX)
    for k, name in enumerate("xyz"):
        vertices[name] = points_m[:, k]
    for k, name in enumerate(("red", "green", "blue")):
        vertices[name] = colors[:, k]
    fields = [f"property {_PLY_TYPES[VERTEX[name].str[1:]]} {name}" for name in VERTEX.names or ()]
    header = ["ply", "format binary_little_endian 1.0", "comment ego frame: x forward, y left, z up; metres"]
    header += [f"element vertex {len(vertices)}", *fields]
    body = vertices.tobytes()
    if triangles is not None:
        faces = np.empty(len(triangles), TRIANGLE)
        faces["count"], faces["corners"] = 3, triangles
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        body += faces.tobytes()
    return "\n".join([*header, "end_header", ""]).encode("ascii") + body
