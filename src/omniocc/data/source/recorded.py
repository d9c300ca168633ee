"""Recorded scenes as a source: any folder or URL of scenes in this project's format."""

import hashlib
import itertools
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Any

from omniocc.camera import Rig
from omniocc.camera.protocol import is_finite
from omniocc.data.labels.voxels import Reach, VoxelCache, cells_beyond
from omniocc.data.source import SPLITS, Ignore, SourceSpec, Split
from omniocc.data.store.files import is_url, list_folders, read_json
from omniocc.data.store.folder import SceneFolder
from omniocc.data.store.meta import DRAWN_RIGS, ORIGIN, RENDERED_REACH_M, panorama_of, plain_spec, read_spec
from omniocc.data.store.reader import SceneReader
from omniocc.data.store.shard import META, digest
from omniocc.errors import FAULTS, DataError, repr_of
from omniocc.geometry import Grid
from omniocc.parallel import usable_cores

SPLITS_FILE = "splits.json"

Splits = Mapping[str, Sequence[str] | float]


class Recorded:
    """A source (`SceneSource`) of scenes that were recorded before.

    Args:
        root: folder or URL (memory://, http://, s3:// ...) that holds the folders of the scenes.
        splits: the scenes of train, val and test: names or patterns (`train-*`), or fractions of all
            scenes. None reads the same from the file `splits.json` in `root`. An empty list is a split without scenes.
        workers: processes that vote for voxels; 0 votes in this process, None takes all usable cores.
        cache: folder for derived data (voxels); None puts it into `root`. A URL as root needs one.
        masks: rig file with the masks of all scenes, as `src/mask.py` writes it; None keeps those that were recorded.
        panorama: width and height (px), upper and lower edge (deg) of the panoramas of true ranges; None: as recorded.

    Raises:
        ValueError: if a URL comes without a cache, `workers` is negative, or `masks` is no rig file.
    """

    def __init__(
        self,
        root: str,
        splits: Splits | None = None,
        workers: int | None = None,
        cache: str | None = None,
        masks: str | None = None,
        panorama: Sequence[float] | None = None,
    ):
        if is_url(root) and cache is None:
            raise ValueError(f"root is a URL ({root}): set cache to a local folder, where voxels are kept")
        if workers is not None and workers < 0:
            raise ValueError(f"workers must be at least 0, got {workers}")
        self.root = root.rstrip("/")
        self.cache = cache
        self.splits = splits
        self.masked = None if masks is None else Rig.load(masks)
        self.panorama = None if panorama is None else panorama_of(panorama)
        self.workers = usable_cores() if workers is None else workers

    @cached_property
    def names(self) -> dict[Split, list[str]]:
        """Return the names of the scenes of every split.

        Raises:
            DataError: naming the split or scene that is missing, or the scene that is in two splits.
        """
        folders = list_folders(self.root, META)
        if self.splits is not None:
            return split_scenes(self.splits, folders, self.root)
        splits = read_json(self.root, SPLITS_FILE, "set data.source.splits to names, patterns or fractions instead")
        try:
            return split_scenes(splits, folders, self.root)
        except DataError as error:
            raise DataError(f"{self.root}/{SPLITS_FILE}: {error}") from error

    @cached_property
    def spec(self) -> SourceSpec:
        """Return the facts recorded with the first scene.

        Raises:
            DataError: when there are no scenes, or the first is damaged.
        """
        if not self._readers:
            raise DataError(f"{self.root}: all splits are empty")
        return spec_of(self._readers[0])

    @property
    def fingerprint(self) -> str:
        """Return a hash of the splits, the checksums of all files, the panorama, and masks if others are given."""
        panorama = [] if self.panorama is None else [repr(self.panorama)]
        return digest([self.names, self._checksums, *self._masks, *panorama])

    @property
    def _masks(self) -> list[str]:
        return [] if self.masked is None else [self.masked.fingerprint]

    @property
    def folder(self) -> Path:
        """Return the local folder of data derived from exactly these scenes."""
        return Path(self.root if self.cache is None else self.cache) / f"recorded-{digest(self._checksums)[:12]}"

    def prepare(self) -> None:
        """Check that all scenes exist and fit together; each may have cameras of its own.

        Raises:
            DataError: when a scene is missing or has other classes, bands, road height or frame rate than the first.
        """
        readers = self._readers
        first = plain_spec(spec_of(readers[0])) if readers else {}
        for reader in readers[1:]:
            for key, value in plain_spec(spec_of(reader)).items():
                if value != first[key]:
                    raise DataError(
                        f"{reader.folder}: its {key} are {value}, those of '{readers[0].name}' are {first[key]}; "
                        "all scenes of data.source.root must agree: leave this one out of data.source.splits"
                    )

    def labels(self, geometry: Grid, ignore: Ignore) -> VoxelCache:
        """Return the voxel labels of a grid, voted from the recorded points."""
        classes, known = self.spec.classes.num_classes, {reach_of(scene) for scene in self._readers}
        reach_m = next((reach for reach in known if reach is not None), None)
        if len(known) > 1 and reach_m is not None and cells_beyond(geometry, reach_m) is not None:
            raise DataError(
                f"{self.root}: points of rendered scenes end at {reach_m[0]:g} m, those of logs do not, and this grid "
                "reaches farther: choose scenes of one kind by data.source.splits, or a smaller grid"
            )
        return VoxelCache(
            self.folder, geometry, ignore, self.fingerprint, classes, self.workers, masks=self._masks, reach_m=reach_m
        )

    def scenes(self, split: Split) -> list[SceneReader]:
        """Return the scenes of a split, in order of their names."""
        locate = f"{self.root}/{{}}".format if is_url(self.root) else Path(self.root).joinpath
        return [SceneReader(locate(name), self.masked, self.panorama) for name in self.names[split]]

    @cached_property
    def _readers(self) -> list[SceneReader]:
        return [reader for split in SPLITS for reader in self.scenes(split)]

    @cached_property
    def _checksums(self) -> list[list[Any]]:
        return sorted([reader.name, reader.meta["files"]] for reader in self._readers)


def spec_of(scene: SceneFolder) -> SourceSpec:
    """Return the facts about its source recorded with a scene; raise DataError when they are missing or wrong.

    Scenes of drawn rigs have no common height of the road, though older ones state one, unless their origin was set.
    """
    try:
        facts = scene.meta["facts"]
        recipe = facts.get("recipe")
        drawn = isinstance(recipe, dict) and str(recipe["rig"]).startswith(DRAWN_RIGS)
        drawn = drawn and not isinstance(recipe.get(ORIGIN), float)
        return read_spec(facts["spec"] | ({"road_z_m": None} if drawn else {}))
    except FAULTS as error:
        raise scene.damaged(META, f"its classes and frame rate cannot be read ({error!r})") from error


def reach_of(scene: SceneFolder) -> Reach | None:
    """Return the distances along x, y and z, m, at which a scene's points end; None: as far as the sensor sees.

    Recorders of the virtual world and of CARLA, which state the kind of place, leave farther points out.
    """
    return RENDERED_REACH_M if "theme" in scene.meta.get("facts", {}) else None


def votes_of(scene: SceneReader, geometry: Grid, ignore: Ignore) -> VoxelCache:
    """Return the labels of a recorded scene in a grid; those that are not kept beside it are voted, and not kept."""
    classes = spec_of(scene).classes.num_classes
    return VoxelCache(Path(scene.folder).parent, geometry, ignore, num_classes=classes, reach_m=reach_of(scene))


def split_scenes(splits: Splits, available: Sequence[str], root: str) -> dict[Split, list[str]]:
    """Return the names of the scenes of every split.

    Raises:
        DataError: naming the split or scene that is missing, or the scene that is in two splits.
    """
    if not available:
        raise DataError(f"data.source.root={root} holds no recorded scenes")
    if not isinstance(splits, Mapping) or set(splits) != set(SPLITS):
        found = sorted(map(str, splits)) if isinstance(splits, Mapping) else repr_of(splits)
        raise DataError(f"data.source.splits has {found}; it needs exactly {', '.join(SPLITS)}")
    fractions = {split: value for split, value in splits.items() if is_finite(value)}
    for split, value in splits.items():
        if is_finite(value):
            continue
        if (
            not isinstance(value, Sequence)
            or isinstance(value, str)
            or not all(isinstance(part, str) for part in value)
        ):
            raise DataError(
                f"data.source.splits.{split} is {repr_of(value)}; give a list of names or patterns, or a fraction"
            )
    if fractions and len(fractions) < len(splits):
        raise DataError(f"data.source.splits={dict(splits)}: give fractions for all splits or for none")
    if fractions:
        return by_fraction(fractions, available)
    found = {split: [name for part in splits[split] for name in matching(part, available, split)] for split in SPLITS}  # type: ignore[union-attr]
    names: dict[Split, list[str]] = {split: sorted(set(found[split])) for split in SPLITS}
    for split, other in itertools.combinations(SPLITS, 2):
        for name in sorted(set(names[split]) & set(names[other])):
            raise DataError(f"data.source.splits: scene '{name}' is in both {split} and {other}")
    return names


def matching(pattern: str, available: Sequence[str], split: str) -> list[str]:
    """Return the scenes that match a name or pattern; raise DataError if there are none."""
    names = [name for name in available if fnmatchcase(name, pattern)]
    if not names:
        close = get_close_matches(pattern, available, n=1) or available[:1]
        raise DataError(
            f"data.source.splits.{split}: no scene is called '{pattern}'; there is '{close[0]}'. "
            "Record scenes for this split, or say which there are: 'data.source.splits={train:1,val:0,test:0}'"
        )
    return names


def by_fraction(fractions: Mapping[str, float], available: Sequence[str]) -> dict[Split, list[str]]:
    """Distribute scenes over splits by fractions, in an order that depends only on their names.

    Raises:
        DataError: if fractions are negative or exceed 1 together, or a split with a fraction above 0 gets no scene.
    """
    if min(fractions.values()) < 0 or sum(fractions.values()) > 1 + 1e-9:
        raise DataError(f"data.source.splits={dict(fractions)}: fractions must be from 0 to 1 and add up to at most 1")
    order = sorted(available, key=lambda name: hashlib.sha256(name.encode()).hexdigest())
    names: dict[Split, list[str]] = {}
    total = 0.0
    for split in SPLITS:
        first, total = round(total * len(order)), total + fractions[split]
        names[split] = sorted(order[first : round(total * len(order))])
        if fractions[split] and not names[split]:
            raise DataError(
                f"data.source.splits.{split}={fractions[split]}: less than one of {len(order)} scenes; give more, or 0"
            )
    return names
