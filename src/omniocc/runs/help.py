"""What `--help` of a command shows: its options and keys, with the comments of their files."""

import textwrap
from collections import Counter
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from string import Template

import hydra
import yaml
from omegaconf import DictConfig

from omniocc.config import CONF, VERSION_BASE

WIDTH = 120
"""Characters of a line."""
NOT_SHOWN = ("defaults", "hydra", "_target_")


def help_text(config_name: str, overrides: list[str]) -> str:
    """Return the help of the command that is configured by `conf/<config_name>.yaml`, with these overrides.

    Its template, `hydra.help.template`, may hold `$GROUPS`: the options of all groups to choose from; `$group`: of one;
    `$KEYS`: the keys of the file; `$group_keys`: the keys of the option that is chosen of a group.

    Raises:
        HydraException: when an override is wrong.
    """
    with hydra.initialize_config_dir(str(CONF), version_base=VERSION_BASE):
        cfg = hydra.compose(config_name, overrides, return_hydra_config=True)
    chosen, template = choices_of(cfg), Template(cfg.hydra.help.template)
    folders = [Path(one.path) for one in cfg.hydra.runtime.config_sources if one.schema == "file"]
    shown = {"KEYS": "\n".join(key_lines(CONF / f"{config_name}.yaml", ""))}
    for name in (name for name in template.get_identifiers() if name not in shown):
        if name.endswith("_keys"):
            group = name.removesuffix("_keys")
            lines = list(key_lines(CONF / group / f"{chosen[group]}.yaml", f"{group}."))
        else:
            groups = chosen if name == "GROUPS" else [name]
            lines = [line for group in groups for line in group_lines(folders, group, chosen.get(group))]
        shown[name] = "\n".join(lines)
    return template.substitute(shown)


def choices_of(cfg: DictConfig) -> dict[str, str]:
    """Return the chosen option of every group that is chosen from once, sorted by name."""
    choices = [(key.partition("@")[0], option) for key, option in cfg.hydra.runtime.choices.items()]
    times = Counter(group for group, _ in choices)
    return {group: option for group, option in sorted(choices) if times[group] == 1 and not group.startswith("hydra/")}


def group_lines(folders: list[Path], group: str, chosen: str | None) -> Iterator[str]:
    """Yield a line for each option of a group, a star at the chosen one; where one has no comment, only all names.

    A group whose only option is chosen has no lines.
    """
    files = {path.stem: path for folder in folders for path in sorted((folder / group).glob("*.yaml"))}
    about = {option: first_comment(path) for option, path in files.items()}
    if list(files) == [chosen]:
        return
    yield group
    if not all(about.values()):
        yield from textwrap.wrap(", ".join(files), WIDTH, initial_indent="    ", subsequent_indent="    ")
        return
    width = max(map(len, files))
    for option, comment in about.items():
        line = f"  {'*' if option == chosen else ' '} {option:{width}}  {comment}"
        yield line if len(line) <= WIDTH else f"{line[: WIDTH - 4].rpartition(' ')[0]} ..."


def first_comment(path: Path) -> str:
    """Return the first line of the comment at the beginning of an option's file, empty without one.

    It ends where the line shows a command.
    """
    for line in path.read_text("utf-8").splitlines():
        if not line.startswith("#"):
            break
        if not line.startswith("# @package"):
            return line.lstrip("# ").partition(": python src/")[0].rstrip(":")
    return ""


def key_lines(path: Path, prefix: str) -> Iterator[str]:
    """Yield lines of `key=value   comment` for the keys of a file, nested ones too; `prefix` stands before each key."""
    text = path.read_text("utf-8")
    root = yaml.compose(text, yaml.SafeLoader)
    for key, value, comment in _entries(text.splitlines(), root, prefix):
        indent, word = " " * 34, f"{key}={value}"
        more = textwrap.wrap(comment, WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)
        if more and len(word) < len(indent):
            more[0] = word + more[0][len(word) :]
        else:
            yield word
        yield from more


def _entries(lines: list[str], node: yaml.MappingNode, prefix: str) -> Iterator[tuple[str, str, str]]:
    """Yield key, value as written, and comment behind it or above it, of every key of a mapping."""
    for key, value in node.value:
        if key.value in NOT_SHOWN:
            continue
        if isinstance(value, yaml.MappingNode) and not value.flow_style:
            yield from _entries(lines, value, f"{prefix}{key.value}.")
            continue
        start, end = value.start_mark, value.end_mark
        written = lines[start.line][start.column : end.column if start.line == end.line else None]
        behind = lines[start.line][end.column :].strip() if start.line == end.line else ""
        above = [*takewhile(lambda line: line.startswith("#"), map(str.strip, lines[: key.start_mark.line][::-1]))]
        comment = [behind] if behind.startswith("#") else above[::-1]
        yield f"{prefix}{key.value}", written, " ".join(line.lstrip("# ") for line in comment)
