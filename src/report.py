"""Tables over all finished runs: `python src/report.py [--runs runs] [--sweeps sweeps] [--output runs/report]`.

Every table of the paper (`sweeps/*.yaml`) as Markdown, CSV and LaTeX, the paper's figures beside ours; also after a
part of a sweep. A run belongs to the row of its name (`+ablation=mono` gives `mono-<hash>`).
"""

import argparse
from pathlib import Path

from omniocc.config import lines_not_tracebacks
from omniocc.report.paper_table import as_csv, as_latex, as_markdown, is_table, load_table
from omniocc.report.runs import by_row, comparable, read_runs, table_of_runs
from omniocc.report.table import markdown
from omniocc.task.run_folder import write_whole

SWEEPS = Path(__file__).parents[1] / "sweeps"


@lines_not_tracebacks
def main(arguments: list[str] | None = None) -> None:
    """Read the runs' own files, print the tables and write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder of runs")
    parser.add_argument("--sweeps", type=Path, default=SWEEPS, help="folder of the paper's tables")
    parser.add_argument("--preset", help="only runs of this preset (default: that of most runs)")
    parser.add_argument("--output", type=Path, help="folder of tables (default: report in the folder of runs)")
    options = parser.parse_args(arguments)
    runs, remark = comparable(read_runs(options.runs), options.preset)
    rows = by_row(runs)
    output = options.output or options.runs / "report"
    output.mkdir(parents=True, exist_ok=True)
    tables = [load_table(path) for path in sorted(options.sweeps.glob("*.yaml")) if is_table(path)]
    parts = [f"{remark}\n", markdown(*table_of_runs(runs)), *(as_markdown(table, rows) for table in tables)]
    text = "\n".join(parts)
    write_whole(output / "report.md", text)
    for table in tables:
        write_whole(output / f"{table.name}.csv", as_csv(table, rows))
        write_whole(output / f"{table.name}.tex", as_latex(table, rows))
    print(f"{text}\n{output}")


if __name__ == "__main__":
    main()
