"""Forge archives of runs (`.tar.xz`): their compression, their headers, and the names in them."""

import gzip
import io
import lzma
import random
import tarfile
from collections.abc import Callable
from pathlib import Path

from mutate import BROKEN, DAMAGED, linked_copy
from sandbox import Box, Case, Opening

KIND = "archives of runs"
ARCHIVE = "runs.tar.xz"
RUN, OTHER = "ours-00000001", "dense-00000001"
FIGURES = f"{RUN}/metrics.json"
Members = dict[str, bytes]


def opened(box: Box, expect: str) -> list[Opening]:
    """Return the report from the archive, and keeping it as a folder and others in it; the archive stays as it is."""
    given, sound, out = str(box.given / ARCHIVE), box.given / "sound", box.out
    linked_copy(box.base / "runs" / RUN, sound / RUN)
    found = [
        Opening(("report.py", "--runs", given, "--output", str(out / "report")), expect, (ARCHIVE,)),
        Opening(("report.py", "--runs", given, "--keep", str(out / "kept")), expect, (ARCHIVE,)),
    ]
    into = Opening(("report.py", "--runs", str(sound), "--keep", given), expect, (ARCHIVE,))
    return [*found, into] if expect == "refused" else found  # a sound archive would be changed


def tar(members: Members, *more: tuple[tarfile.TarInfo, bytes], form: int = tarfile.USTAR_FORMAT) -> bytes:
    """Return a tar archive of files by name and of members whose header is given."""
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w", format=form) as archive:
        for info, content in [*((member(name, len(content)), content) for name, content in members.items()), *more]:
            archive.addfile(info, io.BytesIO(content))
    return file.getvalue()


def member(name: str, size: int = 0, kind: bytes = tarfile.REGTYPE, target: str = "") -> tarfile.TarInfo:
    """Return the header of a member."""
    info = tarfile.TarInfo(name)
    info.size, info.type, info.linkname = size, kind, target
    return info


def claiming(name: str, size: int, kind: bytes = tarfile.REGTYPE) -> bytes:
    """Return a header that claims a size, also one below 0, without content."""
    return member(name, size, kind).tobuf(tarfile.GNU_FORMAT)


def named(name: str) -> Callable[[Members], bytes]:
    """Return what adds a file of a name."""
    return lambda runs: lzma.compress(tar({**runs, name: b"{}"}, form=tarfile.GNU_FORMAT))


def with_member(kind: bytes, target: str = "") -> Callable[[Members], bytes]:
    """Return what adds a member of another kind, and a file that would be written through it."""
    through = member(f"{OTHER}/images/notes.txt", 4), b"evil"
    return lambda runs: lzma.compress(tar(runs, (member(f"{OTHER}/images", 0, kind, target), b""), through))


def claimed(size: int, kind: bytes = tarfile.REGTYPE) -> Callable[[Members], bytes]:
    """Return what puts a header with a wrong size before sound files."""
    return lambda runs: lzma.compress(claiming(f"{OTHER}/table.md", size, kind) + tar(runs))


def bomb(runs: Members) -> bytes:
    """Return an archive of some hundred kB that unpacks to 2 GiB."""
    packer = lzma.LZMACompressor(preset=0)
    parts = [packer.compress(claiming(FIGURES, 2 << 30)), *(packer.compress(bytes(1 << 24)) for _ in range(128))]
    return b"".join([*parts, packer.flush()])


FORGED: dict[str, Callable[[Members], bytes]] = {
    "bomb": bomb,
    "many-files": lambda runs: lzma.compress(b"".join(claiming(f"{RUN}/{k}", 0) for k in range(50_000)) + tar(runs)),
    "dictionary-of-1-gib": lambda runs: lzma.compress(
        tar(runs), filters=[{"id": lzma.FILTER_LZMA2, "preset": 0, "dict_size": 1 << 30}]
    ),
    "named-outward": named("../../neighbour/metrics.json"),
    "named-within-and-outward": named(f"{RUN}/../../../neighbour/metrics.json"),
    "named-absolute": named("/tmp/hostile/metrics.json"),
    "named-hidden": named(f".{RUN}/metrics.json"),
    "named-script": named("<script>document.title='hostile'<|script>/metrics.json"),
    "named-terminal": named("a\x1b[2Jb/metrics.json"),
    "named-long": named("a" * 300 + "/metrics.json"),
    "file-and-folder": named(f"{FIGURES}/metrics.json"),
    "twice": lambda runs: lzma.compress(tar(runs, (member(FIGURES, 2), b"{}"))),
    "link-outward": with_member(tarfile.SYMTYPE, "../../../neighbour"),
    "link-absolute": with_member(tarfile.SYMTYPE, "/etc"),
    "hard-link": with_member(tarfile.LNKTYPE, "../../neighbour/notes.txt"),
    "fifo": with_member(tarfile.FIFOTYPE),
    "device": with_member(tarfile.CHRTYPE),
    "size-negative": claimed(-1024),
    "size-huge": claimed(1 << 60),
    "extended-header-negative": claimed(-512, tarfile.XHDTYPE),
    "extended-header-huge": claimed(1 << 60, tarfile.XHDTYPE),
    "long-name-negative": claimed(-512, tarfile.GNUTYPE_LONGNAME),
    "sparse": claimed(1 << 40, tarfile.GNUTYPE_SPARSE),
    "without-end": lambda runs: lzma.compress(tar(runs).rstrip(b"\0")),
    "more-behind-the-end": lambda runs: lzma.compress(tar(runs) + tar({FIGURES: b"{}"})),
    "gzip": lambda runs: gzip.compress(tar(runs)),
    "not-compressed": tar,
    "two-streams": lambda runs: lzma.compress(tar(runs)) + lzma.compress(tar(runs)),
}
"""What makes the bytes of an archive of the files of runs; all are refused."""


def cases(seed: int) -> list[Case]:
    """Return all cases of a seed."""
    rng = random.Random(f"{KIND} {seed}")
    found = []

    def add(name: str, expect: str, forge: Callable[[Members], bytes], mutate: Callable[[Path], None]) -> None:
        def make(box: Box) -> list[Opening]:
            runs, path = box.base / "runs", box.given / ARCHIVE
            files = [path for run in (RUN, OTHER) for path in sorted((runs / run).rglob("*.*")) if path.is_file()]
            kept = [path for path in files if path.suffix in (".json", ".yaml", ".csv")]
            path.write_bytes(forge({str(file.relative_to(runs)): file.read_bytes() for file in kept}))
            mutate(path)
            return opened(box, expect)

        found.append(Case(KIND, name, make))

    def sound(runs: Members) -> bytes:
        return lzma.compress(tar(runs))

    add("sound", "right", sound, lambda path: None)
    for name, forge in FORGED.items():
        add(name, "refused", forge, lambda path: None)
    for name, mutate in (BROKEN | DAMAGED).items():
        expect, drawn = "refused" if name in BROKEN else "either", rng.random()
        add(name, expect, sound, lambda path, mutate=mutate, drawn=drawn: mutate(path, random.Random(drawn)))
    return found
