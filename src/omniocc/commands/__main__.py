"""`omniocc <command> ...` does what `python src/<command>.py ...` does in a clone of the repository."""

import ast
import sys
from importlib import import_module
from pathlib import Path

import omniocc
from omniocc.runs.script import HELP, print_unknown_command

COMMANDS = {path.stem: path for path in sorted(Path(__file__).parent.glob("[a-z]*.py"))}
"""Files of the commands by name."""


def main() -> None:
    """Run the command that the first argument names; without one, or with `--help`, list all."""
    sys.excepthook = omniocc.end_in_a_line
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in COMMANDS:
        print_unknown_command(name, [*COMMANDS])
        print(listed())
        sys.exit(0 if name in HELP else 2)
    sys.argv[:2] = [str(COMMANDS[name])]  # as if that file had been started: a multirun starts it again
    import_module(f"omniocc.commands.{name}").main()


def listed() -> str:
    """Return the commands with a line each, the beginning of the docstring of its file."""
    lines = ["usage: omniocc <command> ...    (omniocc <command> --help tells more)", ""]
    for name, path in COMMANDS.items():
        about = (ast.get_docstring(ast.parse(path.read_text("utf-8"))) or "").splitlines()[0]
        lines.append(f"  {name:9} {about.partition(': `')[0].partition('; ')[0].rstrip('.')}")
    return "\n".join([*lines, "", "Messages that name `python src/<command>.py` mean `omniocc <command>`."])


if __name__ == "__main__":
    main()
