"""Hashes of code, so that data and runs that other code has made are not taken for one's own."""

import ast
import functools
import hashlib
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, resolve_name
from pathlib import Path


@functools.cache
def code_fingerprint(folder: Path, without: tuple[str, ...] = (), also: tuple[Path, ...] = ()) -> str:
    """Return a hash of the code in a folder and its subfolders, without comments, docstrings and layout.

    Subfolders and files named in `without` do not count; the files `also` do.
    """
    modules = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*.py")}
    modules |= {path.name: path for path in also}
    left_out = {"__pycache__", *without}
    return _digest({name: path for name, path in modules.items() if not left_out & set(name.split("/"))})


def code_of_classes(names: Iterable[str]) -> str:
    """Return a hash of the modules of classes, and of those of the same packages that they import; empty without any.

    Installed packages (in `site-packages`) do not count, nor do comments, docstrings and layout.

    Args:
        names: of the classes, such as `mylib.sketch.Bottom`.
    """
    found: dict[str, Path] = {}
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        path = _own_file(name)
        if path is None and "." in name:
            waiting.append(name.rpartition(".")[0])  # of a class or function: the module that has it
        elif path is not None and found.setdefault(name, path) is path:
            top = f"{name.partition('.')[0]}."
            waiting += [other for other in _imports(name, path) if f"{other}.".startswith(top)]
    return _digest(found) if found else ""


def spec_of(module: str) -> ModuleSpec | None:
    """Return where a package, or a part of one as `package.part`, is installed; None if it cannot be found."""
    try:
        return find_spec(module)
    except ModuleNotFoundError:  # of the package that should have the part
        return None


@functools.cache
def module_of(name: str) -> str:
    """Return the module that defines a class, by the code of the package that offers it, of which nothing is run.

    Args:
        name: of the class, such as `omniocc.model.sketch.Omni`.
    """
    package, _, offered = name.rpartition(".")
    root, *parts = package.split(".")
    spec = spec_of(root)
    place = Path("" if spec is None or spec.origin is None else spec.origin).parent.joinpath(*parts)
    path = next((path for path in (place / "__init__.py", place.with_suffix(".py")) if path.is_file()), None)
    taken = () if path is None else _imports(package, path)
    return next((module_of(found) for found in taken if found.endswith(f".{offered}")), package)


def _own_file(module: str) -> Path | None:
    """Return the file of a module that is not an installed one; None if there is no such module."""
    spec = spec_of(module)
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return None
    installed = (sysconfig.get_path("purelib"), sysconfig.get_path("platlib"), sysconfig.get_path("stdlib"))
    return None if any(Path(spec.origin).is_relative_to(folder) for folder in installed) else Path(spec.origin)


def _imports(module: str, path: Path) -> Iterator[str]:
    """Yield the modules that a module imports, and what it takes from them."""
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), package) if node.level else node.module
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _digest(modules: Mapping[str, Path]) -> str:
    """Return a hash of modules by name: what their code does, and what they are called."""
    digest = hashlib.sha256()
    for name, path in sorted(modules.items()):
        digest.update(f"{name}\n{_bare(path.read_text('utf-8'))}\n".encode())
    return digest.hexdigest()[:16]


def _bare(code: str) -> str:
    """Return what code does, as text, without its comments, docstrings and layout; every version of Python agrees."""
    tree = ast.parse(code)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        first = body[0] if isinstance(body, list) and body else None
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
            first.value.value = ""
    every_list = {"show_empty": True} if sys.version_info >= (3, 13) else {}
    return ast.dump(tree, **every_list).replace(", type_params=[]", "")  # which Python 3.11 does not have
