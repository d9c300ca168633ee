"""Write tables, plots and pages of all finished runs; see `python src/report.py --help`."""

from omniocc.commands.report import main

if __name__ == "__main__":
    main()
