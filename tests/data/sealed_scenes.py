"""Scenes whose content a test chooses, and changes of them with the checksums that fit."""

import json
from pathlib import Path

import numpy as np

from omniocc.camera import Rig
from omniocc.data import SceneReader
from omniocc.data.store.shard import META, SceneWriter, digest, sha256

RIG = Rig.load("surround_view").resized(64, 36)


def scene_of(folder: Path, *frames: dict[str, bytes], rig: Rig = RIG) -> SceneReader:
    """Write a scene with frames of these members."""
    writer = SceneWriter(folder)
    for blobs in frames:
        entry = {"time_s": 0.0, "world_from_ego": np.eye(4).tolist()}
        writer.append({"frame.json": b'{"boxes": []}', **blobs}, entry)
    writer.attach("rig.yaml", rig.save)
    writer.finish({})
    writer.close()
    return SceneReader(folder)


def changed_meta(folder: Path, **facts: object) -> None:
    """Write other facts into a scene, with the digest that fits."""
    meta = {**json.loads((folder / META).read_text()), **facts}
    meta.pop("digest")
    (folder / META).write_text(json.dumps(meta | {"digest": digest(meta)}))


def changed_file(folder: Path, name: str, content: bytes) -> None:
    """Write another file into a scene, with size and checksum that fit."""
    (folder / name).write_bytes(content)
    files = json.loads((folder / META).read_text())["files"]
    changed_meta(folder, files={**files, name: {"size": len(content), "sha256": sha256(folder / name)}})
