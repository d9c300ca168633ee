"""Hydra plug-in: the folders `conf` of the packages in `OMNIOCC_PACKAGES` are searched for options too."""

from importlib.util import find_spec
from pathlib import Path

from hydra.core.config_search_path import ConfigSearchPath
from hydra.plugins.search_path_plugin import SearchPathPlugin

from omniocc.config import allowed


class OwnPackages(SearchPathPlugin):
    """Add `<package>/conf` of every such package that has one; a package that is not installed adds nothing."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Append the folders; of options with the same name the platform's own is found first."""
        for package in allowed(()):
            spec = find_spec(package)
            for place in (spec and spec.submodule_search_locations) or ():
                if (folder := Path(place) / "conf").is_dir():
                    search_path.append(package, f"file://{folder}")
