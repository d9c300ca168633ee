"""Hydra plug-in: the folders `conf` of the packages in `OMNIOCC_PACKAGES` are searched for options too."""

from pathlib import Path

from hydra.core.config_search_path import ConfigSearchPath
from hydra.plugins.search_path_plugin import SearchPathPlugin

from omniocc.config import own_folders
from omniocc.errors import UserError


class OwnPackages(SearchPathPlugin):
    """Add `<package>/conf` of every such package that has one."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Append the folders.

        Raises:
            UserError: when a package cannot be imported, or one of its options has the name of the platform's, which
                Hydra would take instead.
        """
        platform = [
            Path(item.path.removeprefix("file://")) for item in search_path.get_path() if item.provider == "main"
        ]
        for folder in own_folders():
            for option in sorted(folder.rglob("*.yaml")):
                if any((own / option.relative_to(folder)).exists() for own in platform):
                    raise UserError(f"{option} has the name of an option of the platform; give it another")
            search_path.append(folder.parent.name, f"file://{folder}")
