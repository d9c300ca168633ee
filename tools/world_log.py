"""Write scenes of the virtual world as the log of a car: `python tools/world_log.py data/virtual-<hash> logs`.

Each scene becomes a folder of images, poses and scans of one LiDAR without classes, or with `--bag` a bag of ROS 2, as
`src/record.py` reads them. What is recorded, trained on and predicted from such logs can be scored against the scenes.
"""

import argparse
import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32
from scipy.spatial.transform import Rotation

from omniocc.data import SceneReader
from omniocc.data.source.recorded import spec_of
from omniocc.data.store.shard import META
from omniocc.errors import UserError
from omniocc.progress import Progress
from omniocc.runs.script import lines_not_tracebacks

START_NS = 1_700_000_000_000_000_000
"""Clock of the log at the first frame."""
POINTS, POSES = "/points", "/odometry"


def frames_of(scene: SceneReader) -> Iterator[tuple[int, list[np.ndarray], np.ndarray, Float32[np.ndarray, "P 3"]]]:
    """Yield the time, ns, the images, the pose and the LiDAR's points, m, ego frame, of every frame.

    Raises:
        UserError: if the scene has no LiDAR.
    """
    for frame, time_s in enumerate(scene.time_s):
        scan = scene.lidar(frame)
        if scan is None or scan.directions is None:
            raise UserError(f"{scene.folder}: the scene has no LiDAR")
        hit = np.isfinite(scan.range_m) & (scan.range_m > 0)
        points_m = (scan.range_m[hit, None] * scan.directions[hit]).astype(np.float32)
        yield START_NS + round(time_s * 1e9), scene.images(frame), scene.world_from_ego[frame], points_m


def write_rig(scene: SceneReader, path: Path) -> None:
    """Write the rig of a scene, with the height of the road."""
    path.parent.mkdir(parents=True, exist_ok=True)
    replace(scene.rig, road_z_m=spec_of(scene).road_z_m).save(path)


def write_folder(scene: SceneReader, folder: Path) -> None:
    """Write a scene as folders: one of PNG images for each camera, `lidar`, `poses.csv`, `rig.yaml`."""
    write_rig(scene, folder / "rig.yaml")
    rows = ["time,x,y,z,qw,qx,qy,qz"]
    for stamp_ns, images, pose, points_m in frames_of(scene):
        files = [
            (folder / name / f"{stamp_ns}.png", image) for name, image in zip(scene.rig.names, images, strict=True)
        ]
        for path, image in files:
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(png(image).tobytes())
        (folder / "lidar").mkdir(exist_ok=True)
        np.savez(folder / "lidar" / f"{stamp_ns}.npz", points=points_m)
        rows.append(",".join(map(repr, [stamp_ns, *pose[:3, 3].tolist(), *turn_of(pose)])))
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")


def png(image: np.ndarray) -> np.ndarray:
    """Return the bytes of an RGB image as a PNG file."""
    return cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].reshape(-1)


def turn_of(pose: np.ndarray) -> list[float]:
    """Return the quaternion w, x, y, z of a pose."""
    return np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), 1).tolist()


def write_bag(scene: SceneReader, path: Path) -> None:
    """Write a scene as a bag of ROS 2: images, points, odometry; `<path>.yaml` is its rig."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    from omniocc.extras.recorders.bag_writer import CLOUD, FLOAT32, VERSION, header_of

    write_rig(scene, path.with_name(f"{path.name}.yaml"))
    store, topics = get_typestore(Stores.LATEST), {}

    def make(kind: str, **fields: Any) -> Any:
        return store.types[kind](**fields)

    with Writer(path, version=VERSION, storage_plugin=StoragePlugin.MCAP) as writer:

        def write(topic: str, kind: str, stamp_ns: int, frame: str, **fields: Any) -> None:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            message = make(kind, header=header_of(make, stamp_ns, frame), **fields)
            writer.write(topics[topic], stamp_ns, store.serialize_cdr(message, kind))

        for stamp_ns, images, pose, points_m in frames_of(scene):
            for name, image in zip(scene.rig.names, images, strict=True):
                kind = "sensor_msgs/msg/CompressedImage"
                write(f"/{name}/image/compressed", kind, stamp_ns, name, format="png", data=png(image))
            fields = [
                make("sensor_msgs/msg/PointField", name=axis, offset=4 * place, datatype=FLOAT32, count=1)
                for place, axis in enumerate("xyz")
            ]
            size = {"height": 1, "width": len(points_m), "point_step": 12, "row_step": points_m.nbytes}
            data = np.frombuffer(points_m.tobytes(), np.uint8)
            write(POINTS, CLOUD, stamp_ns, "ego", fields=fields, is_bigendian=False, is_dense=True, data=data, **size)
            place = make("geometry_msgs/msg/Point", **dict(zip("xyz", pose[:3, 3].tolist(), strict=True)))
            turn = make("geometry_msgs/msg/Quaternion", **dict(zip("wxyz", turn_of(pose), strict=True)))
            posed = make("geometry_msgs/msg/Pose", position=place, orientation=turn)
            write(POSES, "geometry_msgs/msg/PoseStamped", stamp_ns, "map", pose=posed)


def record_command(scene: SceneReader, bag: Path, output: Path) -> str:
    """Return the command that records a bag that `write_bag` wrote."""
    images = ", ".join(f"{name}: /{name}/image/compressed" for name in scene.rig.names)
    pose = "ego_from_lidar: {position_m: [0, 0, 0], quaternion_wxyz: [1, 0, 0, 0]}"
    options = {"name": scene.name, "bag": bag, "rig": f"{bag}.yaml", "poses": POSES}
    options |= {"cameras": f"{{{images}}}", "lidar": f"{{topic: {POINTS}, {pose}}}"}
    words = [f"output={output}", "recorder=bag", *(f"recorder.{key}={value}" for key, value in options.items())]
    return shlex.join(["python", "src/record.py", *words])


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Write every scene of a folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, help="folder of rendered scenes, or of one scene")
    parser.add_argument("logs", type=Path, help="folder of the logs")
    parser.add_argument(
        "--bag", action="store_true", help="bags instead of folders; prints the commands to record them"
    )
    options = parser.parse_args(arguments)
    folders = [options.scenes] if (options.scenes / META).is_file() else sorted(options.scenes.glob("[!.]*/"))
    scenes = [SceneReader(folder) for folder in folders if (folder / META).is_file()]
    if not scenes:
        raise UserError(f"{options.scenes} holds no scenes: python src/render.py makes some")
    with Progress(f"writing {options.logs}", sum(map(len, scenes))) as progress:
        for scene in scenes:
            (write_bag if options.bag else write_folder)(scene, options.logs / scene.name)
            for _ in range(len(scene)):
                progress.advance()
    if options.bag:
        folder = options.logs.with_name(f"recorded_{options.logs.name}")
        print("\n".join(record_command(scene, options.logs / scene.name, folder) for scene in scenes))


if __name__ == "__main__":
    main()
