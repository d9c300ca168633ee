"""Forge checkpoints and files of weights whose configuration, pickle or tensors are hostile."""

import copy
import functools
import io
import json
import pickle
import random
import struct
import tarfile
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from mutate import BROKEN, DAMAGED
from safetensors.torch import save
from sandbox import Box, Case, Opening, some

from omniocc.runs.weights import FORMAT, digest_of

KIND = "checkpoints"
SLOTS = ("model.backbone", "model.sketch.depth.loss", "model.lifter", "loss.voxel.ce", "optimizer", "augment", "data")
"""Where a class stands in the configuration."""
PLAIN = ("model.lifter.anchors.0", "model.backbone.weights", "data.source.splits.test", "ema_decay", "data.seed")
"""Where a plain value stands."""
BUILT = {
    "depth": ("depth", "data"),
    "occupancy": ("model", "data"),
    "submission": ("model", "loss", "data"),
    "evaluate": ("model", "loss", "optimizer", "augment", "data"),
    "robustness": ("model", "loss", "data"),
    "view": ("model", "loss", "data"),
    "export": ("model", "data"),
    "weights": (),
    "resume": (),
}
"""Parts of a checkpoint's configuration that a command builds."""
COMMANDS = 2
"""Commands that open a hostile checkpoint, drawn at random: all of them read it by the same function."""
Tree = dict[str, Any]


@functools.cache
def content_of(base: Path) -> Tree:
    """Return the content of the sound checkpoint."""
    return torch.load(base / "run" / "best.ckpt", weights_only=True)


def commands(box: Box, path: Path) -> dict[str, tuple[str, ...]]:
    """Return every command that opens a checkpoint, by name."""
    images, out, base = f"images={box.base / 'frame'}", f"output={box.out / 'result'}", box.base
    rig = f"rig={base / 'rig.yaml'}"
    data = (
        "data=recorded",
        f"data.source.root={base / 'scenes'}",
        "data.source.splits={train:[test-000-*],val:[test-001-*],test:[test-002-*]}",
    )
    paths = (f"paths.runs={box.out / 'runs'}", f"paths.data={box.out / 'data'}", f"data.source.cache={box.out / 'c'}")
    train = ("train.py", "preset=smoke", *data, *paths, "logger.mode=disabled")
    return {
        "depth": ("predict.py", "depth", f"checkpoint={path}", rig, images, out),
        "occupancy": ("predict.py", "occupancy", f"checkpoint={path}", rig, images, out, "overview=false"),
        "submission": ("predict.py", "submission", f"checkpoint={path}", out),
        "evaluate": ("evaluate.py", str(path), "--output", str(box.out / "result"), "--images", "0", paths[2]),
        "robustness": ("evaluate.py", str(path), "robustness=view_180_deg", "--output", str(box.out / "result")),
        "view": ("view.py", f"run={path}", f"recorded={base / 'scenes'}", "page=true", "limit=1", f"{out}.html"),
        "export": ("export.py", f"checkpoint={path}", rig, f"{out}.pt2"),
        "weights": (*train, f"weights={path}", "plan=true"),
        "resume": (*train, f"resume={path}", "model/sketch=dense"),
    }


def openings(box: Box, path: Path, part: str | None = None, only: Sequence[str] = ()) -> list[Opening]:
    """Return the commands; all of them must refuse the file that build `part` of its configuration, None: all."""
    found = []
    for name, command in commands(box, path).items():
        if not only or name in only:
            refused = part is None or part in BUILT[name]
            found.append(Opening(command, "refused" if refused else "either", (path.name,)))
    return found


def write_weights(path: Path, about: Any, tensors: Mapping[str, torch.Tensor]) -> None:
    """Write a file of weights with this text, or the JSON of this tree, as its configuration."""
    text = about if isinstance(about, str) else json.dumps(about)
    path.write_bytes(save({name: value.clone() for name, value in tensors.items()}, {FORMAT: text}))


def write(path: Path, content: Tree) -> None:
    """Write a checkpoint, or a file of weights, by the suffix of its name."""
    if path.suffix == ".ckpt":
        torch.save(content, path)
    else:
        about = {"stage": content["stage"], "config": content["config"], "facts": {}}
        write_weights(path, about | {"sha256": digest_of(content["state_dict"])}, content["state_dict"])


def put(tree: Any, place: str, value: Any) -> None:
    """Set the value at a place of a tree, `a.b.0`."""
    *way, last = place.split(".")
    for key in way:
        tree = tree[int(key)] if isinstance(tree, list) else tree[key]
    if isinstance(tree, list):
        tree[int(last)] = value
    else:
        tree[last] = value


def touch(box: Box, name: str) -> str:
    """Return a shell command that leaves a mark."""
    return f"touch {box.marks / name}"


def call(target: str, *arguments: Any, **named: Any) -> Tree:
    """Return a node that calls a function."""
    return {"_target_": target} | ({"_args_": list(arguments)} if arguments else {}) | named


def nodes(box: Box, path: Path) -> dict[str, Any]:
    """Return nodes that run code, write, listen or load when they are built, by name."""
    mark = str(box.marks / "built")
    shell, evil = touch(box, "os-system"), box.given / "evil.py"
    at_place = call("pathlib.Path", mark)
    return {
        "os.system": call("os.system", shell),
        "posix.system": call("posix.system", shell),
        "subprocess": call("subprocess.Popen", ["touch", mark]),
        "eval": call("builtins.eval", f"open({mark!r}, 'w')"),
        "exec": call("builtins.exec", f"open({mark!r}, 'w')"),
        "open": call("builtins.open", mark, "w"),
        "write_text": call("pathlib.Path.write_text", at_place, "text"),
        "mkdir": call("os.mkdir", mark),
        "touch-path": call("pathlib.Path.touch", at_place),
        "rmtree": call("shutil.rmtree", str(box.neighbour)),
        "torch.load": call("torch.load", str(evil.with_suffix(".pt")), weights_only=False),
        "torch.hub": call("torch.hub.load", str(box.given), "evil", source="local"),
        "torch.serialization": call("torch.serialization.load", str(evil.with_suffix(".pt")), weights_only=False),
        "torch.save": call("torch.save", {}, mark),
        "torch.jit": call("torch.jit.load", str(evil.with_suffix(".pt"))),
        "torch.utils.download": call("torch.hub.download_url_to_file", evil.as_uri(), mark),
        "cpp-extension": call("torch.utils.cpp_extension.load_inline", name="evil", cpp_sources=""),
        "trainer": call("lightning.pytorch.Trainer", default_root_dir=mark, logger=False),
        "csv-logger": call("lightning.pytorch.loggers.CSVLogger", mark),
        "wandb-logger": call("lightning.pytorch.loggers.WandbLogger", save_dir=mark, offline=True),
        "lightning-cli": call("lightning.pytorch.cli.LightningCLI"),
        "checkpoint-callback": call("lightning.pytorch.callbacks.ModelCheckpoint", dirpath=mark),
        "instantiate": call("hydra.utils.instantiate", call("os.system", shell)),
        "hydra-call": call("hydra.utils.call", call("os.system", shell), _recursive_=False),
        "get_method": call("hydra.utils.get_method", "os.system"),
        "omegaconf-load": call("omegaconf.OmegaConf.load", str(box.neighbour / "notes.txt")),
        "omegaconf-save": call("omegaconf.OmegaConf.save", {"a": 1}, mark),
        "own-import-os": call("omniocc.io.os.system", shell),
        "own-import-path": call("omniocc.io.Path", mark),
        "own-import-subprocess": call("omniocc.runs.fork_server.subprocess.Popen", ["touch", mark]),
        "own-function-atomic-write": call("omniocc.io.atomic_write", at_place, "text"),
        "own-function-build": call("omniocc.config.build", call("os.system", shell)),
        "own-function-load": call("omniocc.load", str(path)),
        "fork-server": {"_target_": "omniocc.runs.fork_server.ForkServer", "script": str(evil), "log": f"{mark}.log"},
        "fork-server-of-itself": {
            "_target_": "omniocc.runs.fork_server.ForkServer",
            "script": str(path),
            "log": f"{mark}.log",
        },
        "scene-writer": {"_target_": "omniocc.data.store.shard.SceneWriter", "folder": mark},
        "watch-server": {"_target_": "omniocc.extras.viewer.watch.server.Server", "runs": str(box.given), "port": 0},
        "files-chained": {
            "_target_": "omniocc.data.store.files.Files",
            "folder": f"filecache::{evil.as_uri()}?cache_storage={mark}",
        },
        "files-object": call("omniocc.data.store.files.Files", folder=f"simplecache::{box.given.as_uri()}"),
        "loggers": call("omniocc.runs.wandb.Loggers", project="x", group="x", mode="online", tags=[]),
        "curves": {"_target_": "omniocc.runs.wandb.loggers.WandbCurves", "save_dir": mark},
        "carla": {
            "_target_": "omniocc.extras.recorders.carla.recorder.CarlaRecorder",
            "restart": shell,
            "python": str(evil),
        },
        "log-files": {"_target_": "omniocc.extras.recorders.files.LogFiles", "name": "train-0", "log": str(box.given)},
        "checkpoint-io": {"_target_": "omniocc.train.checkpoint_plugin.AtomicCheckpointIO"},
        "launcher": {"_target_": "hydra_plugins.process_launcher.launcher.ProcessLauncher"},
        "other-slot": {"_target_": "omniocc.model.refiner.NoRefiner"},
        "other-slot-sketch": {"_target_": "omniocc.model.sketch.Dense"},
        "error-class": {"_target_": "omniocc.errors.UserError"},
        "torch-module": {"_target_": "torch.nn.Linear", "in_features": 3, "out_features": 3},
        "own-package": {"_target_": "evil.Evil"},
        "relative-target": {"_target_": "..os.system", "_args_": [shell]},
        "target-of-text": {"_target_": ["os.system"], "_args_": [shell]},
        "target-null": {"_target_": None},
        "target-empty": {"_target_": ""},
        "target-nested": {"_target_": call("os.system", shell)},
        "target-interpolated": {"_target_": "${stage}.system", "_args_": [shell]},
    }


FLAGS: dict[str, Tree] = {
    "": {},
    "partial": {"_partial_": True},
    "not-recursive": {"_recursive_": False},
    "convert": {"_convert_": "object"},
}
INTERPOLATIONS = {
    "env": "${oc.env:HOSTILE_SECRET}",
    "env-in-text": "a${oc.env:HOSTILE_SECRET}b",
    "env-escaped": "\\${oc.env:HOSTILE_SECRET}",
    "env-twice-escaped": "\\\\${oc.env:HOSTILE_SECRET}",
    "create": "${oc.create:{_target_:os.system,_args_:['{shell}']}}",
    "create-escaped": "\\${oc.create:{_target_:os.system,_args_:['{shell}']}}",
    "decode": "${oc.decode:'{_target_: os.system}'}",
    "hydra": "${hydra:runtime.cwd}",
    "dict-values": "${oc.dict.values:model}",
    "to-itself": "${ema_decay}",
    "to-the-root": "${model}",
    "to-nothing": "${no.such.key}",
    "unclosed": "${model",
    "nested": "${${oc.env:HOSTILE_SECRET}}",
    "select": "${oc.select:oc.env,${oc.env:HOSTILE_SECRET}}",
}


def helpers(box: Box) -> None:
    """Write the code and the pickle that hostile nodes refer to; all of them leave a mark."""
    code = f"open({str(box.marks / 'imported')!r}, 'w')\nclass Evil: pass\ndef evil(): pass\n"
    for place in (box.given / "evil.py", box.given / "hubconf.py", box.work / "evil.py"):
        place.write_text(code)
    (box.given / "evil.pt").write_bytes(pickle.dumps(Reduced(touch(box, "unpickled"))))


class Reduced:
    """An object whose pickle runs a shell command."""

    def __init__(self, command: str):
        self.command = command

    def __reduce__(self) -> tuple[Any, ...]:
        import os

        return os.system, (self.command,)


def of_config(name: str, place: str, value: Callable[[Box, Path], Any], suffix: str) -> Case:
    """Return the case of a sound file with another value at a place of its configuration."""

    def make(box: Box) -> list[Opening]:
        helpers(box)
        path = box.given / f"{name}{suffix}"
        content = dict(content_of(box.base))
        content["config"] = copy.deepcopy(content["config"])
        given = value(box, path)
        put(content["config"], place, given)
        if place.startswith("model.sketch.depth"):  # the stage of the depth has it at another place
            put(content["config"], place.removeprefix("model.sketch."), given)
        write(path, content)
        if name.startswith("fork-server-of-itself"):
            append_main(path, box)
        part = place.partition(".")[0]
        also = "depth" if place.startswith("model.sketch.depth") else part
        return [
            Opening(one.command, "refused" if part in BUILT[key] or also in BUILT[key] else "either", one.names)
            for key, one in zip(commands(box, path), openings(box, path), strict=True)
            if key not in ("submission", "robustness") or part == "data"
        ]

    return Case(KIND, f"{name}{suffix}", make)


def append_main(path: Path, box: Box) -> None:
    """Make a checkpoint a program too: Python runs the `__main__.py` of any zip file."""
    if path.suffix == ".ckpt":
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr("__main__.py", f"open({str(box.marks / 'main')!r}, 'w')")


def config_cases(rng: random.Random) -> Iterator[Case]:
    """Yield a case for every node and every interpolation, at places drawn at random."""
    example = Path("example")
    for name in nodes(Box.__new__(_Nowhere), example):
        place, flag = rng.choice(SLOTS if rng.random() < 0.6 else PLAIN), rng.choice(list(FLAGS))
        suffix, listed = rng.choice((".ckpt", ".safetensors")), place in PLAIN and rng.random() < 0.3

        def value(box: Box, path: Path, name: str = name, flag: str = flag, listed: bool = listed) -> Any:
            node = nodes(box, path)[name] | FLAGS[flag]
            return [node] if listed else node

        label = "-".join(filter(None, [name, "listed" * listed, "in", place, flag]))
        yield of_config(label, place, value, suffix)
    for name, text in INTERPOLATIONS.items():
        place = rng.choice((*SLOTS, *PLAIN))

        def text_at(box: Box, path: Path, text: str = text) -> str:
            return text.replace("{shell}", touch(box, "oc-create"))

        yield of_config(f"interpolation-{name}-in-{place}", place, text_at, rng.choice((".ckpt", ".safetensors")))
    for name in ("env", "create", "env-escaped"):

        def in_key(box: Box, path: Path, name: str = name) -> Any:
            return {INTERPOLATIONS[name].replace("{shell}", touch(box, "oc-create")): 1}

        yield of_config(f"interpolation-{name}-in-key", "optimizer", in_key, ".safetensors")


class _Nowhere(Box):
    """A box of no folders, to list the names of nodes."""

    folder = given = work = marks = out = home = temporary = neighbour = base = Path("/nowhere")

    def __init__(self) -> None:
        pass


VALUES: dict[str, tuple[str, Callable[[Box], Any], bool]] = {
    "huge-channels": ("model.backbone.hidden_sizes", lambda box: [10**9] * 4, True),
    "huge-grid": ("model.geometry.shape", lambda box: [10**6, 10**6, 10**6], True),
    "negative-grid": ("model.geometry.shape", lambda box: [-16, 20, 4], True),
    "many-layers": ("model.lifter.layers", lambda box: 10**9, True),
    "many-classes": ("model.num_classes", lambda box: 2**40, True),
    "number-of-400-digits": ("model.num_classes", lambda box: 10**400, True),
    "deep-list": ("model.lifter.anchors", lambda box: functools.reduce(lambda a, _: [a], range(400), []), True),
    "deep-mapping": ("model.backbone", lambda box: functools.reduce(lambda a, _: {"a": a}, range(400), {}), True),
    "model-is-text": ("model", lambda box: "omniocc.model.OccupancyModel", True),
    "model-is-null": ("model", lambda box: None, True),
    "model-is-list": ("model", lambda box: [], True),
    "data-is-number": ("data", lambda box: 7, False),
    "nan-argument": ("data.seed", lambda box: float("nan"), False),
    "root-outside": ("data.source.root", lambda box: str(box.neighbour), False),
    "root-url": ("data.source.root", lambda box: "http://127.0.0.1:9/scenes", False),
    "root-chained": ("data.source.root", lambda box: f"filecache::{box.given.as_uri()}", False),
    "cache-outside": ("data.source.cache", lambda box: str(box.marks / "cache"), False),
    "paths-outside": ("paths", lambda box: {"runs": str(box.marks), "data": str(box.marks)}, False),
    "weights-of-pickle": ("model.backbone.weights", lambda box: str(box.given / "evil.pt"), False),
    "weights-of-url": ("model.backbone.weights", lambda box: "http://127.0.0.1:9/evil", False),
    "packages-of-its-own": ("packages", lambda box: ["evil", "os"], False),
    "workers": ("data.num_workers", lambda box: 10**6, False),
    "masks-of-pickle": ("data.source.masks", lambda box: str(box.given / "evil.pt"), False),
    "nul-in-path": ("data.source.root", lambda box: "a\0b", False),
    "surrogate-in-path": ("data.source.root", lambda box: "a\udcff", False),
    "long-path": ("data.source.root", lambda box: "a/" * 5000, False),
    "terminal-codes": ("data.source.root", lambda box: "\x1b]0;evil\x07\x1b[2J", False),
}
"""Place, value, and whether every command that builds the part must refuse it."""


def value_cases(rng: random.Random) -> Iterator[Case]:
    """Yield a case for every hostile plain value."""
    for name, (place, value, refused) in VALUES.items():
        suffix = rng.choice((".ckpt", ".safetensors"))
        case = of_config(name, place, lambda box, path, value=value: value(box), suffix)

        def make(box: Box, case: Case = case, refused: bool = refused, value: Any = value) -> list[Opening]:
            found = list(case.make(box))
            named = (*found[0].names, str(value(box)), repr(value(box)))  # a path that is not there is named instead
            return found if refused else [Opening(one.command, "either", named) for one in found]

        yield Case(KIND, case.name, make)


def _changed(tensors: Mapping[str, torch.Tensor], change: Callable[[torch.Tensor], torch.Tensor]) -> Tree:
    """Return weights whose largest floating tensor is changed."""
    largest = max(
        (name for name in tensors if tensors[name].is_floating_point()), key=lambda name: tensors[name].numel()
    )
    return {**tensors, largest: change(tensors[largest])}


TENSORS: dict[str, Callable[[Tree], Tree]] = {
    "nan-weights": lambda w: _changed(w, lambda t: torch.full_like(t, float("nan"))),
    "infinite-weights": lambda w: _changed(w, lambda t: torch.full_like(t, float("inf"))),
    "weights-left-out": lambda w: dict(list(w.items())[3:]),
    "weights-added": lambda w: {**w, "model.evil": torch.ones(3)},
    "other-shape": lambda w: _changed(w, lambda t: torch.zeros(3, 3)),
    "no-weights": lambda w: {},
    "nul-in-name": lambda w: {**w, "model.\0evil": torch.ones(3)},
    "path-as-name": lambda w: {**w, "model.../../evil": torch.ones(3)},
}


def tensor_cases(rng: random.Random) -> Iterator[Case]:
    """Yield a case for every change of the weights."""
    for name, change in TENSORS.items():
        for suffix in (".ckpt", ".safetensors"):

            def make(box: Box, name: str = name, suffix: str = suffix, change: Any = change) -> list[Opening]:
                path = box.given / f"{name}{suffix}"
                content = dict(content_of(box.base))
                content["state_dict"] = change(content["state_dict"])
                write(path, content)
                only = ("occupancy", "evaluate", "view", "export")
                return [*openings(box, path, only=only), *openings(box, path, "", ("depth", "weights", "resume"))]

            yield Case(KIND, f"{name}{suffix}", make)


def _header(path: Path, header: bytes, length: int | None = None, body: bytes = b"") -> None:
    path.write_bytes(struct.pack("<Q", len(header) if length is None else length) + header + body)


def _about(base: Path, **changes: Any) -> Tree:
    content = content_of(base)
    about = {"stage": content["stage"], "config": content["config"], "facts": {}}
    return about | {"sha256": digest_of(content["state_dict"])} | changes


def _doubled_keys(path: Path, base: Path) -> None:
    """Write a configuration with the key `model` twice: which one is checked, which one built?"""
    text = json.dumps(_about(base))
    write_weights(path, text.replace('"model": {', '"model": {"_target_": "os.system"}, "model": {', 1), _weights(base))


def _weights(base: Path) -> Tree:
    return content_of(base)["state_dict"]


SAFETENSORS: dict[str, Callable[[Path, Path], Any]] = {
    "header-of-exabytes": lambda path, base: _header(path, b"{}", 2**62),
    "header-of-99-megabytes": lambda path, base: _header(path, b"{}" + b" " * 99_000_000),
    "shape-of-gigabytes": lambda path, base: _header(
        path, json.dumps({"a": {"dtype": "F32", "shape": [2**40], "data_offsets": [0, 2**42]}}).encode()
    ),
    "shape-overflows": lambda path, base: _header(
        path, json.dumps({"a": {"dtype": "F32", "shape": [2**63] * 2, "data_offsets": [0, 4]}}).encode(), None, b"0000"
    ),
    "header-doubled-keys": lambda path, base: _header(path, b'{"__metadata__":{"a":"b"},"__metadata__":{"a":"c"}}'),
    "header-not-utf8": lambda path, base: _header(path, b'{"__metadata__":{"\xff":"\xfe"}}'),
    "header-deep": lambda path, base: _header(path, b'{"__metadata__":' + b"[" * 100_000),
    "metadata-of-nothing": lambda path, base: write_weights(path, "", _weights(base)),
    "metadata-no-json": lambda path, base: write_weights(path, "{model: 1", _weights(base)),
    "metadata-a-list": lambda path, base: write_weights(path, "[1, 2]", _weights(base)),
    "metadata-a-number": lambda path, base: write_weights(path, "NaN", _weights(base)),
    "metadata-deep-lists": lambda path, base: write_weights(path, "[" * 200_000, _weights(base)),
    "metadata-deep-mappings": lambda path, base: write_weights(
        path,
        json.dumps(_about(base, config=0)).replace(": 0,", ": " + '{"a":' * 9000 + "1" + "}" * 9000 + ",", 1),
        _weights(base),
    ),
    "metadata-without-hash": lambda path, base: write_weights(
        path, {key: value for key, value in _about(base).items() if key != "sha256"}, _weights(base)
    ),
    "metadata-without-config": lambda path, base: write_weights(
        path, {key: value for key, value in _about(base).items() if key != "config"}, _weights(base)
    ),
    "metadata-wrong-hash": lambda path, base: write_weights(path, _about(base, sha256="0" * 64), _weights(base)),
    "metadata-hash-a-number": lambda path, base: write_weights(path, _about(base, sha256=7), _weights(base)),
    "metadata-stage-a-list": lambda path, base: write_weights(path, _about(base, stage=["occupancy"]), _weights(base)),
    "metadata-stage-unknown": lambda path, base: write_weights(path, _about(base, stage="evil"), _weights(base)),
    "metadata-config-a-list": lambda path, base: write_weights(path, _about(base, config=[1]), _weights(base)),
    "metadata-config-empty": lambda path, base: write_weights(path, _about(base, config={}), _weights(base)),
    "metadata-config-null": lambda path, base: write_weights(path, _about(base, config=None), _weights(base)),
    "metadata-text-of-60-megabytes": lambda path, base: write_weights(
        path, _about(base, config={"model": "x" * 60_000_000}), _weights(base)
    ),
    "metadata-infinite": lambda path, base: write_weights(
        path, json.dumps(_about(base)).replace('"num_classes": 12', '"num_classes": 1e999'), _weights(base)
    ),
    "metadata-doubled-keys": _doubled_keys,
}


def _torch_zip(path: Path, pickled: bytes, **members: bytes) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in {"archive/data.pkl": pickled, "archive/version": b"3\n", **members}.items():
            archive.writestr(name, content)


def _bomb(path: Path) -> None:
    """Write a zip whose one member is two gigabytes of zeros."""
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("archive/data.pkl", "w", force_zip64=True) as member,
    ):
        for _ in range(2048):
            member.write(bytes(2**20))


def _tar(path: Path, command: str) -> None:
    with tarfile.open(path, "w") as archive:
        for name in ("storages", "tensors", "pickle"):
            content = pickle.dumps(Reduced(command))
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))


def _with(base: Path, **changes: Any) -> Tree:
    return content_of(base) | changes


def _saved(path: Path, content: Any, **options: Any) -> None:
    torch.save(content, path, **options)


PICKLES: dict[str, Callable[[Path, Box], Any]] = {
    "pickle-plain": lambda path, box: path.write_bytes(pickle.dumps(Reduced(touch(box, path.stem)))),
    "pickle-in-zip": lambda path, box: _torch_zip(path, pickle.dumps(Reduced(touch(box, path.stem)), 2)),
    "pickle-in-tar": lambda path, box: _tar(path, touch(box, path.stem)),
    "pickle-among-weights": lambda path, box: _saved(path, _with(box.base, evil=Reduced(touch(box, path.stem)))),
    "pickle-in-config": lambda path, box: _saved(
        path, _with(box.base, config={"model": Reduced(touch(box, path.stem))})
    ),
    "pickle-old-format": lambda path, box: _saved(
        path, _with(box.base, evil=Reduced(touch(box, path.stem))), _use_new_zipfile_serialization=False
    ),
    "old-format": lambda path, box: _saved(path, content_of(box.base), _use_new_zipfile_serialization=False),
    "zip-bomb": lambda path, box: _bomb(path),
    "zip-outward-names": lambda path, box: _torch_zip(path, b"N.", **{f"../../marks/{path.stem}": b"x"}),
    "zip-empty": lambda path, box: zipfile.ZipFile(path, "w").close(),
    "expanded-tensor": lambda path, box: _saved(
        path, _with(box.base, state_dict=_changed(_weights(box.base), lambda t: torch.zeros(1).expand(2**36)))
    ),
    "config-a-text": lambda path, box: _saved(path, _with(box.base, config="model")),
    "config-a-list": lambda path, box: _saved(path, _with(box.base, config=[1, 2])),
    "config-of-objects": lambda path, box: _saved(path, _with(box.base, config={"model": {1, 2}})),
    "config-holds-tensors": lambda path, box: _saved(path, _with(box.base, config={"model": torch.ones(3)})),
    "weights-a-list": lambda path, box: _saved(path, _with(box.base, state_dict=[torch.ones(3)])),
    "weights-of-text": lambda path, box: _saved(path, _with(box.base, state_dict={"model.a": "text"})),
    "weights-numbered": lambda path, box: _saved(path, _with(box.base, state_dict={1: torch.ones(3)})),
    "weights-complex": lambda path, box: _saved(
        path, _with(box.base, state_dict=_changed(_weights(box.base), lambda t: t.to(torch.complex64)))
    ),
    "weights-sparse": lambda path, box: _saved(
        path, _with(box.base, state_dict=_changed(_weights(box.base), lambda t: t.to_sparse()))
    ),
    "weights-on-cuda": lambda path, box: _saved(
        path, _with(box.base, state_dict=_changed(_weights(box.base), lambda t: t.to("meta")))
    ),
    "stage-a-list": lambda path, box: _saved(path, _with(box.base, stage=["occupancy"])),
    "stage-missing": lambda path, box: _saved(path, {k: v for k, v in content_of(box.base).items() if k != "stage"}),
    "a-list": lambda path, box: _saved(path, [1, 2, 3]),
    "a-tensor": lambda path, box: _saved(path, torch.ones(3)),
}


def file_cases(rng: random.Random) -> Iterator[Case]:
    """Yield files that are hostile as files: headers, pickles, archives, damaged bytes."""
    for name, forge in SAFETENSORS.items():

        def make(box: Box, name: str = name, forge: Any = forge) -> list[Opening]:
            path = box.given / f"{name}.safetensors"
            forge(path, box.base)
            return openings(box, path, only=("depth", "occupancy", "evaluate", "view", "weights"))

        yield Case(KIND, f"{name}.safetensors", make)
    for name, forge in PICKLES.items():

        def make_pickle(box: Box, name: str = name, forge: Any = forge) -> list[Opening]:
            path = box.given / f"{name}.ckpt"
            forge(path, box)
            if name == "old-format":
                return openings(box, path, "", only=("depth", "occupancy"))
            only = ("depth", "occupancy", "evaluate", "view", "export", "resume")  # a plan loads no weights
            return openings(box, path, only=only if name.startswith("weights") else (*only, "weights"))

        yield Case(KIND, f"{name}.ckpt", make_pickle)
    for name, mutation in (BROKEN | DAMAGED).items():
        suffix = rng.choice((".ckpt", ".safetensors"))
        seed = rng.random()

        def make_broken(
            box: Box, name: str = name, mutation: Any = mutation, suffix: str = suffix, seed: float = seed
        ) -> list[Opening]:
            path = box.given / f"{name}{suffix}"
            write(path, content_of(box.base))
            mutation(path, random.Random(seed))
            part = None if name in BROKEN or suffix == ".safetensors" else ""
            return openings(box, path, part, only=("occupancy", "evaluate", "weights", "resume"))

        yield Case(KIND, f"{name}{suffix}", make_broken)


def control_cases() -> Iterator[Case]:
    """Yield the sound files: if a command refused them, it would refuse the others for no reason of theirs."""
    for suffix in (".ckpt", ".safetensors"):

        def make(box: Box, suffix: str = suffix) -> list[Opening]:
            path = box.given / f"sound{suffix}"
            write(path, content_of(box.base))
            only = ("depth", "occupancy", "evaluate", "view", "weights")
            return [Opening(one.command, "right", one.names) for one in openings(box, path, only=only)]

        yield Case(KIND, f"sound{suffix}", make)


def cases(seed: int) -> list[Case]:
    """Return all cases of a seed; a hostile file is opened by some of the commands."""
    rng = random.Random(f"{KIND} {seed}")
    found = [*config_cases(rng), *value_cases(rng), *tensor_cases(rng), *file_cases(rng)]
    return [*control_cases(), *(_less(case, rng.random()) for case in found)]


def _less(case: Case, seed: float) -> Case:
    return case._replace(make=lambda box: some(case.make(box), COMMANDS, random.Random(seed)))
