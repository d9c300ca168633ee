"""Bundle the part of three.js that the viewer's page needs: `python tools/vendor_three.py 0.187.0`.

Takes three and the bundler esbuild from npm (whose client checks their published hashes) and writes `three.min.js`,
the licence and `VERSION`, which names the version and the SHA-256 of the bundle, into
`src/omniocc/extras/viewer/page/vendor`. `--check` bundles the version named there again and compares, and writes
nothing.
"""

import argparse
import hashlib
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "src" / "omniocc" / "extras" / "viewer" / "page" / "vendor"
ESBUILD = "0.28.2"
NAMES = (
    "BufferAttribute",
    "BufferGeometry",
    "Color",
    "DataTexture",
    "DoubleSide",
    "Group",
    "LineBasicMaterial",
    "LineSegments",
    "Mesh",
    "MeshBasicMaterial",
    "PerspectiveCamera",
    "Scene",
    "ShaderMaterial",
    "Vector3",
    "WebGLRenderer",
    "WebGLRenderTarget",
)
"""What the page's modules import from three."""
ENTRY = f"""\
export {{ {", ".join(NAMES)} }} from "three";
export {{ OrbitControls }} from "three/examples/jsm/controls/OrbitControls.js";
"""


def main() -> None:
    """Write the bundle, or compare it with the one there is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("version", nargs="?", default=None, help="of three, such as 0.187.0; default: the one there is")
    parser.add_argument("--check", action="store_true", help="compare with the files there are, write nothing")
    arguments = parser.parse_args()
    version = arguments.version or (FOLDER / "VERSION").read_text().split()[1]
    with tempfile.TemporaryDirectory() as folder:
        files = bundle(version, Path(folder))
    if arguments.check:
        differing = [name for name, content in files.items() if (FOLDER / name).read_bytes() != content]
        sys.exit(f"{FOLDER}: {', '.join(differing)} differ from three {version}" if differing else 0)
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (FOLDER / name).write_bytes(content)
        print(f"{FOLDER / name}: {len(content)} bytes")


def bundle(version: str, folder: Path) -> dict[str, bytes]:
    """Return the content of the vendored files by name."""
    if shutil.which("npm") is None:
        sys.exit("npm is missing: install Node.js (apt-get install nodejs npm)")
    (folder / "package.json").write_text('{"private": true}')
    (folder / "entry.js").write_text(ENTRY)
    npm = ["npm", "install", "--silent", "--no-audit", f"three@{version}", f"esbuild@{ESBUILD}"]
    esbuild = [folder / "node_modules/.bin/esbuild", "entry.js", "--bundle", "--minify", "--format=esm"]
    for command in (
        npm,
        [*esbuild, "--charset=ascii", "--legal-comments=inline", "--log-level=error", "--outfile=three.min.js"],
    ):
        subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    code = (folder / "three.min.js").read_bytes()
    digest = hashlib.sha256(code).hexdigest()
    return {
        "three.min.js": code,
        "LICENSE": (folder / "node_modules/three/LICENSE").read_bytes(),
        "VERSION": f"three {version} esbuild {ESBUILD} sha256 {digest}\n".encode(),
    }


if __name__ == "__main__":
    main()
