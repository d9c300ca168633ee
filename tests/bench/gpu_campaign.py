"""One part of the measurements on a first GPU: `python tests/bench/gpu_campaign.py <part> <folder> [--preset paper]`.

`gpu_campaign.sh` runs all parts. Each writes its rows to `<folder>/parts/<part>-<preset>.json`; every call then joins
the rows of all parts as `campaign.json` and `campaign.md`. Times are the best of the repeats, memory is the peak above
what was held before, as in `bench_model.py`; 'plain' is the same by `grid_sample` or by scattering, on the same device.
"""

import argparse
import copy
import json
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import torch
from bench_model import CONF, Inputs, Meter, slot_runs, total
from bench_systems import SYSTEMS, Sequence, make_model
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig
from torch import Tensor
from torch.nn import functional as F

from omniocc.camera import Rig, normalize_pixels
from omniocc.config import build
from omniocc.metric import RayIoU
from omniocc.model import Stream
from omniocc.model.lifter.lift_splat import find_entries, splat
from omniocc.model.ops.deformable_attention import deformable_sum, make_level, make_table
from omniocc.model.ops.depth.projection import Present, Projection, alternate_cameras, field_weight, samplers, table
from omniocc.model.ops.padding import pad3d
from omniocc.model.ops.visible import every_cell
from omniocc.model.sketch import Dense
from omniocc.runs.folder import git_commit
from omniocc.runs.machine import keep_freed_memory

ROOT = Path(__file__).parents[2]
PUBLIC_RAYIOU = 29.0
"""Frames/s of the CUDA kernel of SparseOcc's RayIoU, as its users report."""
TRAIN_S = 480.0

Row = dict[str, Any]


def compose_preset(preset: str, *overrides: str) -> DictConfig:
    """Return the configuration of training, without pretrained weights."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("train", overrides=[f"preset={preset}", "model.backbone.weights=null", *overrides])


def precisions(device: torch.device) -> Iterator[tuple[str, Callable[[], AbstractContextManager]]]:
    """Return float32 and bfloat16 by name, each with what to run under."""
    yield "float32", nullcontext
    yield "bfloat16", lambda: torch.autocast(device.type, torch.bfloat16)


def measured(meter: Meter, run: Callable[[], object], trains: bool) -> Row:
    """Return milliseconds and MiB, forward and, if it trains, with backward."""
    with torch.no_grad():
        forward, memory = meter.measure(run)
    row = {"forward_ms": forward, "forward_mib": memory}
    if trains:
        both, held = meter.measure(lambda: total(run()).backward())
        row |= {"with_backward_ms": both, "with_backward_mib": held}
    return row


def slots(preset: str, meter: Meter) -> Iterator[Row]:
    """Measure every slot and the whole step."""
    cfg = compose_preset(preset)
    model = build(cfg.model).to(meter.device)
    inputs = Inputs(cfg, model, meter.device)
    for precision, context in precisions(meter.device):
        for name, _, run, trains in slot_runs(model, inputs):

            def under(run: Callable[[], object] = run, context: Callable = context) -> object:
                with context():
                    return run()

            yield {"name": name, "precision": precision} | measured(meter, under, trains)


def agreement(preset: str, meter: Meter) -> Iterator[Row]:
    """Compare logits and gradients of every system with those of the CPU, from equal weights, images and candidates."""
    torch.backends.cudnn.allow_tf32 = False
    cpu = torch.device("cpu")
    for name, model_name in SYSTEMS.items():
        cfg = compose_preset(preset, f"model={model_name}")
        model = make_model(cfg, cpu)
        model.sketch = Dense(model.geometry)
        inputs = Sequence(cfg, model, cpu)
        expected, found = (logits_and_gradients(inputs, device) for device in (cpu, meter.device))
        of_logits, of_gradients = map(relative_difference, found, expected)
        yield {"name": name, "of_logits": of_logits, "of_gradients": of_gradients}


def logits_and_gradients(inputs: Sequence, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the logits of a copy of the model on a device, and the gradients of its parameters."""
    model = copy.deepcopy(inputs.model).to(device)
    logits = model(inputs.images.to(device), inputs.rigs, inputs.poses.to(device)).logits
    logits.square().mean().backward()
    gradients = [parameter.grad.flatten() for parameter in model.parameters() if parameter.grad is not None]
    return logits.detach().cpu(), torch.cat(gradients).cpu()


def relative_difference(values: Tensor, reference: Tensor) -> float:
    """Return the norm of the difference over that of the reference."""
    return float((values - reference).norm() / reference.norm())


def compiled(preset: str, meter: Meter) -> Iterator[Row]:
    """Measure the two slots of convolutions as they are and by `torch.compile`, with the time of the first call."""
    cfg = compose_preset(preset)
    model = build(cfg.model).to(meter.device)
    inputs = Inputs(cfg, model, meter.device)
    for slot in ("backbone", "refiner"):
        module, arguments = getattr(model, slot), inputs.of(slot)
        yield {"name": slot} | measured(meter, lambda module=module, inputs=arguments: module(*inputs), True)
        fast, start = torch.compile(module), time.perf_counter()
        total(fast(*arguments)).backward()
        first_s = round(time.perf_counter() - start, 1)
        row = measured(meter, lambda fast=fast, inputs=arguments: fast(*inputs), True)
        yield {"name": f"{slot}, compiled", "first_call_s": first_s} | row


def operations(preset: str, meter: Meter) -> Iterator[Row]:
    """Measure the operations that are written on plain torch here, each beside its plain version."""
    cfg = compose_preset(preset)
    width, height = cfg.preset.data.virtual.image_size
    rig, device = Rig.load("fisheye6").resized(width, height), meter.device
    for name, ours, plain in (
        ("attention to image features", *attention_pair(cfg, rig, device)),
        ("sphere sweep", *sweep_pair(cfg, rig, device)),
        ("lift, splat", *splat_pair(cfg, rig, device)),
        ("warp of a volume", *warp_pair(cfg, device)),
    ):
        with torch.no_grad():
            apart = float((ours() - plain()).abs().max())
        yield {"name": name, "largest_difference": apart} | measured(meter, ours, True)
        yield {"name": f"{name}, plain"} | measured(meter, plain, True)


Pair = tuple[Callable[[], Tensor], Callable[[], Tensor]]


def attention_pair(cfg: DictConfig, rig: Rig, device: torch.device) -> Pair:
    """Return one layer of the lifter's attention, and the same by `grid_sample` for every camera."""
    lifter, geometry = cfg.model.lifter, build(cfg.model.geometry)
    heads, points, channels = lifter.heads, lifter.points, lifter.channels // lifter.heads
    _, _, pairs = every_cell(rig, geometry, device, ((0.0, 0.0, 0.0),))
    stride = cfg.model.backbone.levels[0]
    height, width = -(-rig.cameras[0].height // stride), -(-rig.cameras[0].width // stride)
    maps = torch.randn(1, len(rig.cameras), heads, channels, height, width, device=device, requires_grad=True)
    offsets = torch.randn(heads, 1, 2, len(pairs.counts), points, device=device, requires_grad=True)
    weights = torch.rand(heads, 1, len(pairs.counts), points, device=device, requires_grad=True)
    level = make_level(pairs, height, width, points, heads, torch.float32)
    size = torch.tensor([width, height], device=device)

    def ours() -> Tensor:
        return deformable_sum([make_table(maps)], offsets, weights, [level])

    def plain() -> Tensor:
        sums = maps.new_zeros(len(pairs.counts), heads, channels)
        for camera in range(len(rig.cameras)):
            chosen = pairs.camera == camera
            query = pairs.query[chosen]
            places = pairs.points[chosen] + offsets[:, 0, :, query].movedim(1, -1) * 2 / size
            samples = F.grid_sample(maps[0, camera], places, align_corners=False)
            part = (samples * weights[:, 0, query][:, None]).sum(-1)
            sums = sums.index_add(0, query, part.permute(2, 0, 1))
        return sums.movedim(1, 0)

    return ours, plain


def sweep_pair(cfg: DictConfig, rig: Rig, device: torch.device) -> Pair:
    """Return the features of every other camera on all spheres by sparse matrices, and by `grid_sample`."""
    depth = build(cfg.depth)
    spheres, channels = depth.rig_spheres(rig), depth.match_channels
    size = rig.cameras[0].width // 2, rig.cameras[0].height // 2
    cameras = alternate_cameras(rig)[0]
    planes = tuple(float(plane) for plane in range(spheres.count))
    blocks = samplers(rig, Projection(depth.swept, spheres, size, cameras, planes), device)
    features = torch.randn(1, len(rig.cameras), channels, size[1], size[0], device=device, requires_grad=True)
    present = Present(torch.ones(1, len(rig.cameras), dtype=torch.bool, device=device), True)
    rays = depth.swept.rays().double().reshape(-1, 3)
    points_m = torch.cat([rays * (1 / (k * spheres.step_per_m) if k else 1e6) for k in planes])
    pixels, valid = rig.project(points_m)
    places, weights = [], []
    for k in cameras:
        inside = torch.where(valid[k, :, None], pixels[k], 0.0)
        places.append(normalize_pixels(inside, rig.cameras[k].width, rig.cameras[k].height).float().to(device))
        u, v = inside.round().long().unbind(-1)
        weight = field_weight(rig, k)
        weights.append((weight[v.clamp(0, weight.shape[0] - 1), u.clamp(0, weight.shape[1] - 1)] * valid[k]).to(device))
    weights = torch.stack(weights) / torch.stack(weights).sum(0).clamp(min=1e-9)

    def ours() -> Tensor:
        rows = table(features, present)
        return torch.cat([block(rows) for block in blocks])

    def plain() -> Tensor:
        swept = features.new_zeros(channels, len(points_m))
        for camera, place, weight in zip(cameras, places, weights, strict=True):
            sampled = F.grid_sample(features[:, camera], place[None, None], padding_mode="border", align_corners=False)
            swept = swept + sampled[0, :, 0] * weight
        return swept.T

    return ours, plain


def splat_pair(cfg: DictConfig, rig: Rig, device: torch.device) -> Pair:
    """Return lift and splat without the outer product, and with it and `index_add`."""
    cfg = compose_preset(cfg.preset.name, "model/lifter=lift_splat")
    option, grid = cfg.model.lifter, build(cfg.model.geometry)
    stride = cfg.model.backbone.levels[-1]
    height, width = -(-rig.cameras[0].height // stride), -(-rig.cameras[0].width // stride)
    step = (option.range_m[1] - option.range_m[0]) / option.bins
    ranges_m = tuple(option.range_m[0] + (index + 0.5) * step for index in range(option.bins))
    entries = find_entries(rig, grid, height, width, ranges_m, device)
    pixels = len(rig.cameras) * height * width
    context = torch.randn(pixels, option.channels, device=device, requires_grad=True)
    scores = torch.randn(pixels, option.bins, device=device, requires_grad=True)
    pixel = torch.div(entries.slot, option.bins, rounding_mode="floor")

    def plain() -> Tensor:
        values = context[pixel] * scores.softmax(-1).flatten()[entries.slot, None]
        return context.new_zeros(grid.num_cells, option.channels).index_add(0, entries.voxel.long(), values)

    return lambda: splat(context, scores.softmax(-1), entries), plain


def warp_pair(cfg: DictConfig, device: torch.device) -> Pair:
    """Return a volume moved by a metre as temporal fusion does it, and by `grid_sample`."""
    grid, pose = build(cfg.model.geometry), torch.eye(4, dtype=torch.float64, device=device)
    pose[0, 3] = 1.0
    volume = torch.randn(1, cfg.preset.channels, *grid.shape, device=device, requires_grad=True)
    wraps = tuple(map(int, grid.periodic))
    cells = torch.tensor(grid.shape, device=device)
    centers = grid.centers(torch.float64).reshape(-1, 3).to(device)

    def plain() -> Tensor:
        moved = centers @ pose[:3, :3].T + pose[:3, 3]
        places = torch.stack(grid.coordinates(moved), dim=-1)
        inside = ((places >= 0) & (places < cells)).all(-1)
        around = torch.tensor(wraps, device=device)
        scaled = 2 * (places + around) / (cells + 2 * around) - 1
        padded = pad3d(volume, wraps, grid.periodic)  # type: ignore[arg-type]
        sampled = F.grid_sample(
            padded, scaled.flip(-1).float().view(1, *grid.shape, 3), padding_mode="border", align_corners=False
        )
        return sampled * inside.view(grid.shape)

    return lambda: grid.warp(volume, pose[None]), plain


def rayiou(preset: str, meter: Meter) -> Iterator[Row]:
    """Measure frames/s of RayIoU on both grids, and of its rays cell by cell."""
    for name in ("cylinder", "cuboid"):
        grid = build(compose_preset(preset, f"model/geometry={name}").model.geometry)
        metric = RayIoU(grid).to(meter.device)
        labels = torch.zeros(1, *grid.shape, dtype=torch.uint8, device=meter.device)
        labels[torch.rand(labels.shape, device=meter.device) < 0.01], labels[..., :2] = 4, 1
        with torch.no_grad():
            ms, mib = meter.measure(lambda metric=metric, labels=labels: metric.update(labels.roll(1, 2), labels))
        yield {
            "name": f"RayIoU, {name}",
            "forward_ms": ms,
            "forward_mib": mib,
            "per_s": 1e3 / ms,
            "public": PUBLIC_RAYIOU,
        }


def streaming(preset: str, meter: Meter) -> Iterator[Row]:
    """Measure whole frames of a drive: depth, sketch and occupancy, past frames remembered."""
    cfg = compose_preset(preset)
    model = build(cfg.model).to(meter.device).eval()
    width, height = cfg.preset.data.virtual.image_size
    rig = Rig.load("fisheye6").resized(width, height)
    images = torch.randint(0, 256, (6, 3, height, width), dtype=torch.uint8, device=meter.device)
    poses = torch.eye(4, dtype=torch.float64, device=meter.device).repeat(100, 1, 1)
    poses[:, 0, 3] = torch.arange(100)
    for precision, context in precisions(meter.device):
        stream, numbers = Stream(model), iter(range(100))

        def frame(stream: Stream = stream, numbers: Iterator[int] = numbers, context: Callable = context) -> object:
            with context():
                return stream.step(images, rig, poses[next(numbers)])

        for _ in range(model.temporal.frames):
            frame()
        ms, mib = meter.measure(frame)
        yield {"name": "a frame", "precision": precision, "forward_ms": ms, "forward_mib": mib, "per_s": 1e3 / ms}


def training(preset: str, meter: Meter) -> Iterator[Row]:
    """Train for eight minutes, or to the end; the same command goes on."""
    command = [sys.executable, str(ROOT / "src/train.py"), f"preset={preset}", "name=campaign"]
    process = subprocess.Popen([*command, "logger.mode=disabled"], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    start = time.monotonic()
    try:
        output, _ = process.communicate(timeout=TRAIN_S)
    except subprocess.TimeoutExpired:
        process.terminate()
        output, _ = process.communicate()
    lines = [line.strip() for line in output.replace("\r", "\n").splitlines() if "steps" in line]
    seconds = round(time.monotonic() - start)
    yield {"name": "training", "seconds": seconds, "code": process.returncode, "progress": lines[-1] if lines else ""}


PARTS = {
    "agreement": agreement,
    "slots": slots,
    "compiled": compiled,
    "operations": operations,
    "rayiou": rayiou,
    "streaming": streaming,
    "training": training,
}


def machine(device: torch.device) -> Row:
    """Return what the figures depend on."""
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else platform.processor() or platform.machine()
    return {"device": name, "torch": torch.__version__, "commit": git_commit(), "date": time.strftime("%Y-%m-%d")}


def join(folder: Path) -> None:
    """Write the rows of all parts as `campaign.json` and `campaign.md`."""
    parts = {path.stem: json.loads(path.read_text()) for path in sorted((folder / "parts").glob("*.json"))}
    (folder / "campaign.json").write_text(json.dumps(parts, indent=1))
    lines = []
    for name, part in parts.items():
        columns = list(dict.fromkeys(key for row in part["rows"] for key in row))
        facts = ", ".join(f"{key} {value}" for key, value in part["machine"].items())
        lines += [f"## {name}", "", facts, "", f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
        lines += [f"| {' | '.join(as_text(row.get(column)) for column in columns)} |" for row in part["rows"]] + [""]
    (folder / "campaign.md").write_text("\n".join(lines))


def as_text(value: object) -> str:
    """Return a table's entry."""
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def main() -> None:
    """Measure one part, unless its file is there, and join all."""
    parser = argparse.ArgumentParser(description="Measure one part on a GPU.")
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--preset", default="small")
    parser.add_argument("--device", default="cuda", type=torch.device)
    parser.add_argument("--repeats", default=10, type=int)
    chosen = parser.parse_args()
    path = chosen.folder / "parts" / f"{chosen.part}-{chosen.preset}.json"
    if path.exists():
        print(f"{path} is there")
        return
    torch.manual_seed(0)
    keep_freed_memory()
    rows = []
    for row in PARTS[chosen.part](chosen.preset, Meter(chosen.device, torch.get_num_threads(), chosen.repeats)):
        print(json.dumps(row), flush=True)
        rows.append(row)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"machine": machine(chosen.device), "rows": rows}, indent=1))
    join(chosen.folder)


if __name__ == "__main__":
    main()
