"""One table over all finished runs: `python src/report.py [--runs runs] [--output runs/report.md]`."""

import argparse
from pathlib import Path

from omniocc.config import lines_not_tracebacks
from omniocc.report.runs import read_runs, table_of_runs
from omniocc.report.table import markdown
from omniocc.task.run_folder import write_whole


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Read the runs' own files, print the table and write it as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder of runs")
    parser.add_argument("--output", type=Path, help="Markdown file (default: report.md in the folder of runs)")
    options = parser.parse_args(arguments)
    text = markdown(*table_of_runs(read_runs(options.runs)))
    output = options.output or options.runs / "report.md"
    write_whole(output, text)
    print(f"{text}\n{output}")


if __name__ == "__main__":
    main()
